// SPDX-License-Identifier: MIT
#include "broker/sockets/turn.h"

#include <algorithm>
#include <boost/asio/post.hpp>
#include <cmath>
#include <utility>

namespace eigencast::broker {

bool Gathering::waits(std::uint64_t poses, TimeUs now_us) {
  constexpr TimeUs kPeriodUs = 100'000;
  if (settings_.tick_us == 0) return false;
  const TimeUs passed = now_us - period_start_us_;
  if (passed >= kPeriodUs) {
    const std::uint64_t limit = settings_.above_per_second / (waits_ ? 2 : 1);
    waits_ = poses_ * 1'000'000 > limit * static_cast<std::uint64_t>(passed);
    poses_ = 0;
    period_start_us_ = now_us;
  }
  poses_ += poses;
  return waits_;
}

Turn::Turn(asio::io_context& loop, const Settings& settings, LogSink log, std::function<bool()> deliver)
    : loop_(loop),
      log_(std::move(log)),
      deliver_(std::move(deliver)),
      wants_uring_(settings.uring),
      gathering_(settings.gathering),
      timer_(loop.get_executor()) {}

void Turn::begin() {
  if (!wants_uring_ || ring_) return;
  auto ring = open_uring();
  if (ring) {
    held_.reserve(kMaxBatch);  // hold() must not throw: what is sent counts as sent.
    return void(ring_ = std::move(*ring));
  }
  log(log_, LogLevel::kWarning, "writes go one by one, because io_uring is unavailable: " + ring.error().message);
}

TimeUs Turn::begin_turn() {
  now_us_ = steady_now_us();
  arm_end();
  return now_us_;
}

void Turn::add(SocketWriter& writer, bool may_wait) {
  using Queue = SocketWriter::Queue;
  const Queue queue = writer.queue_;
  if (queue == Queue::kNow || queue == Queue::kLate || (may_wait && queue == Queue::kTick)) return;
  forget(writer);
  writer.queue_ = may_wait ? SocketWriter::Queue::kTick : SocketWriter::Queue::kNow;
  auto& list = list_of(writer.queue_);
  writer.slot_ = static_cast<std::uint32_t>(list.size());
  list.push_back(&writer);
  may_wait ? arm_tick() : arm_end();
}

void Turn::forget(SocketWriter& writer) {
  if (is_sending(writer)) submit();
  if (writer.queue_ == SocketWriter::Queue::kNone) return;
  list_of(writer.queue_)[writer.slot_] = nullptr;
  writer.queue_ = SocketWriter::Queue::kNone;
}

void Turn::arm_end() {
  if (std::exchange(end_armed_, true)) return;
  asio::post(loop_, [this] { end_turn(); });
}

void Turn::end_turn() {
  try {
    const bool more = deliver_();
    end_armed_ = false;
    flush_all(now_);
    if (more) arm_end();
  } catch (...) {  // The next turn retries, so there must be one.
    end_armed_ = false;
    now_us_ = 0;
    at_once_ = 0;
    throw;
  }
  now_us_ = 0;
  at_once_ = late_.empty() ? 0 : kAtOnce;
}

void Turn::arm_tick() {
  if (std::exchange(tick_armed_, true)) return;
  timer_.expires_at(
      std::chrono::steady_clock::time_point(std::chrono::microseconds(gathering_.next_tick_us(now_us()))));
  timer_.async_wait([this](ErrorOf error) {
    tick_armed_ = false;
    if (!error) flush_all(tick_);
  });
}

void Turn::flush_all(std::vector<SocketWriter*>& list) {
  submit();
  // Writers with bytes left, or with new output from the others' outcomes, enter the next turn.
  flushing_.clear();  // Left over from a failed turn.
  flushing_.swap(list);
  std::erase(flushing_, nullptr);
  for (SocketWriter* writer : flushing_) writer->queue_ = SocketWriter::Queue::kNone;
  double us = 0;
  for (const SocketWriter* writer : flushing_) us += writer->write_us();
  const bool fits = late_.empty() && us <= kSliceUs;
  us = 0;
  for (SocketWriter* writer : flushing_) {
    if (fits && us <= kSliceUs)
      us += flush_for(*writer);
    else
      put_off(*writer);
  }
  flushing_.clear();
  flush_slice();
}

/// Returns how long it took, in microseconds, as it may make what it writes, or will take in the batch.
double Turn::flush_for(SocketWriter& writer) {
  const TimeUs from_us = steady_now_us();
  flush(writer);
  const auto us = static_cast<double>(steady_now_us() - from_us);
  return is_sending(writer) ? std::max(us, writer.write_us()) : us;
}

void Turn::flush(SocketWriter& writer) {
  const int socket = ring_ ? writer.plain_socket() : -1;
  if (socket < 0) return writer.flush();
  if (batched_ == kMaxBatch || !has_room(*ring_)) submit();
  if (!add_pieces(*ring_, writer, socket)) return;
  writer.batch_ = batch_;
  ++batched_;
}

void Turn::put_off(SocketWriter& writer) {
  forget(writer);  // Another's flush may have added it anew.
  if (late_free_.empty()) {
    late_free_.push_back(static_cast<std::uint32_t>(late_writers_.size()));
    late_writers_.push_back(nullptr);
  }
  const std::uint32_t place = late_free_.back();
  late_.push(writer.purse(), static_cast<std::int64_t>(std::ceil(writer.write_us())), place);
  late_free_.pop_back();
  late_writers_[place] = &writer;
  writer.slot_ = place;
  writer.queue_ = SocketWriter::Queue::kLate;
}

void Turn::flush_slice() {
  for (double us = 0; !late_.empty() && us < kSliceUs;) {
    const auto next = late_.pop();
    late_free_.push_back(next.item);
    SocketWriter* writer = std::exchange(late_writers_[next.item], nullptr);
    if (writer == nullptr) continue;
    writer->queue_ = SocketWriter::Queue::kNone;
    us += std::max(static_cast<double>(next.cost), flush_for(*writer));
  }
  submit();
  if (!late_.empty()) arm_end();
}

void Turn::submit() {
  if (batched_ == 0) return;
  write_batch(*ring_);
  batched_ = 0;
  ++batch_;
  tell_writers(*ring_);
  held_.clear();
  held_last_ = nullptr;
}

void Turn::hold(std::shared_ptr<const void> owner) {
  held_last_ = owner.get();
  held_.push_back(std::move(owner));
}

}  // namespace eigencast::broker
