// SPDX-License-Identifier: MIT
#include "sdk/broker_publisher.h"

#include <mutex>

namespace eigencast {

namespace {

Result<void> check_capture_time(TimeUs capture_us) {
  if (capture_us >= 0 && capture_us <= limits::kMaxTimeUs) return {};
  return fail(ErrorCode::kInvalidArgument,
              "capture time " + std::to_string(capture_us) + " us is out of range: it must be 0 to 2^62 - 1");
}

}  // namespace

SendStatus BrokerPublisher::send_key(Key key, TimeUs capture_us, ByteView coded, std::optional<std::uint32_t> phase) {
  const TimeUs begun_us = steady_now_us();
  const std::lock_guard lock(mutex_);
  if (const auto early = send_blocker(capture_us)) return *early;
  return send_coded(now_->writer.code_as(std::move(key), coded, phase, capture_us), {begun_us, 0});
}

SendStatus BrokerPublisher::send_coefficients(std::span<const double> C, TimeUs capture_us, std::span<const double> V) {
  return send(C, V, {}, capture_us, {steady_now_us(), 0});
}

Result<SendStatus> BrokerPublisher::send_pose(const VertexPose& pose, TimeUs capture_us) {
  (void)take_change();
  if (auto usable = check_capture_time(capture_us); !usable) return usable.error();
  const TimeUs begun_us = steady_now_us();
  const auto made = now_->projection.project(pose);
  if (!made) return made.error();
  learn_from(pose, made->C, capture_us);
  return send(made->C, made->V, made->S, capture_us, {begun_us, steady_now_us()});
}

std::vector<double> BrokerPublisher::as_received() const {
  const std::lock_guard lock(mutex_);
  return now_->writer.positions_held();
}

void BrokerPublisher::restart_still() {
  still_.reset();
  if (now_->asset && options_.still_heartbeat_us > 0)
    still_.emplace(kStillOverError * error_bound(options_, *now_->asset), options_.still_heartbeat_us);
}

SendStatus BrokerPublisher::send(std::span<const double> C, std::span<const double> V, std::span<const double> S,
                                 TimeUs capture_us, const Work& work) {
  const std::lock_guard lock(mutex_);
  if (V.empty() == options_.velocities)
    return unusable(fail(ErrorCode::kInvalidArgument, V.empty() ? "a pose without velocities, which were announced"
                                                                : "velocities that were not announced"));
  if (S.size() != now_->format.rows * now_->format.scalars.size())
    return unusable(fail(ErrorCode::kInvalidArgument, "a pose without the scalars that were announced, or with more"));
  std::vector<double> all;
  if (now_->format.channels > 3) C = all = rows_in_format(now_->format, C, V, S);
  if (ramp_ && C.size() == std::size_t{now_->format.rows} * now_->format.channels)
    C = all = ramp_->blended(C, now_->format.channels);
  if (const auto early = send_blocker(capture_us)) return *early;
  auto key = key_from_coefficients(now_->writer.layout(), C, now_->quantiser.step);
  if (!key) return unusable(key.error());
  if (!now_->writer.held() || !still_) return send_next(std::move(*key), capture_us, work);
  return send_unless_still(std::move(*key), C, capture_us, work);
}

SendStatus BrokerPublisher::send_unless_still(Key key, std::span<const double> C, TimeUs capture_us, const Work& work) {
  const StillGate before = *still_;
  const double distance =
      surface_distance(C, coefficients_from_key(now_->writer.layout(), *now_->writer.held()), now_->asset->area);
  switch (still_->next(distance, capture_us)) {
    case StillGate::Action::kSkip:
      ++stats_.frames_held;
      return SendStatus::kSent;
    case StillGate::Action::kHold: {
      const SendStatus held = send_next(*now_->writer.held(), capture_us, work);
      if (held != SendStatus::kSent) still_ = before;
      return held;
    }
    case StillGate::Action::kResume:
      if (const auto held = send_next(*now_->writer.held(), still_->held_until_us(), work); held != SendStatus::kSent) {
        still_ = before;
        return held;
      }
      [[fallthrough]];
    case StillGate::Action::kSend:
      break;
  }
  return send_next(std::move(key), capture_us, work);
}

SendStatus BrokerPublisher::send_next(Key key, TimeUs capture_us, const Work& work) {
  if (!now_->memory.decides()) return send_coded(now_->writer.code(std::move(key), capture_us), work);
  auto coded = now_->writer.code(key, capture_us);
  return send_coded(std::move(coded), work, &key);
}

std::optional<SendStatus> BrokerPublisher::send_blocker(TimeUs capture_us) {
  if (state_ != State::kLive) return dropped(DropReason::kDisconnected);
  if (socket_->unsent_bytes() > options_.max_unsent_bytes) return dropped(DropReason::kBehind);
  if (auto usable = check_capture_time(capture_us); !usable) return unusable(usable.error());
  if (!now_->writer.may_follow(capture_us)) return dropped(DropReason::kTime);
  return std::nullopt;
}

SendStatus BrokerPublisher::send_coded(Result<KeyWriter::Coded> coded, const Work& work, const Key* pose) {
  if (!coded) return unusable(coded.error());
  const std::size_t bytes = coded->message.size();
  const bool recalled = coded->next.phase.has_value();
  // Before it is handed over: the broker may have it before the call returns.
  const TimeUs sent_us = steady_now_us();
  const SendStatus status = socket_->send_binary(std::move(coded->message));
  if (status != SendStatus::kSent)
    return dropped(status == SendStatus::kDisconnected ? DropReason::kDisconnected : DropReason::kBehind);
  if (pose != nullptr && now_->writer.state() != nullptr) keep(*pose, *coded, bytes);
  now_->writer.sent(*std::move(coded), bytes);
  if (ramp_) {
    ramp_->sent();
    if (ramp_->is_over()) ramp_.reset();
  }
  ++stats_.frames_sent;
  if (recalled) ++stats_.frames_recalled;
  stats_.payload_bytes += bytes;
  if (trace_every_ != 0) trace(work, sent_us);
  return status;
}

SendStatus BrokerPublisher::dropped(DropReason why) {
  ++stats_.frames_dropped;
  ++stats_.dropped_for[static_cast<std::size_t>(why)];
  return why == DropReason::kDisconnected ? SendStatus::kDisconnected : SendStatus::kDropped;
}

SendStatus BrokerPublisher::unusable(const Error& why) {
  if (stats_.detail != why.message) log(log_, LogLevel::kError, "frame not sent: " + why.message);
  stats_.detail = why.message;
  return dropped(DropReason::kUnusable);
}

void BrokerPublisher::trace(const Work& work, TimeUs sent_us) {
  const TimeUs now = steady_now_us();
  if (now_->writer.sequence() % trace_every_ == 0) {
    control::Trace m;
    m.stream_id = now_->writer.stream_id();
    m.epoch = now_->writer.epoch();
    m.sequence = now_->writer.sequence();
    m.stages.emplace_back(control::stage::kStarted, work.begun_us);
    if (work.transformed_us != 0) m.stages.emplace_back(control::stage::kTransformed, work.transformed_us);
    m.stages.emplace_back(control::stage::kSent, sent_us);
    if (const auto clock = clock_.estimate()) m.broker_clock = {clock->offset_us, clock->error_us};
    (void)socket_->send_text(text_from_control(m));
  }
  if (now - last_ping_us_ < kPingIntervalUs) return;
  last_ping_us_ = now;
  (void)socket_->send_text(text_from_control(control::Ping{++ping_id_, now}));
}

}  // namespace eigencast
