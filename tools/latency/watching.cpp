// SPDX-License-Identifier: MIT
#include "tools/latency/watching.h"

#include <algorithm>
#include <future>

#include "common/core/clock.h"
#include "common/net/url.h"

namespace eigencast::latency {

using std::chrono::milliseconds;

bool on_this_machine(const std::string& url) {
  const auto parsed = parse_broker_url(url);
  return parsed && (parsed->host == "localhost" || parsed->host == "::1" || parsed->host.rfind("127.", 0) == 0);
}

Watching::Watching(const Inputs& inputs, bool one_clock, TimeUs start_us)
    : inputs_(inputs),
      one_clock_(one_clock),
      start_us_(start_us),
      timeline_({one_clock, one_clock && on_this_machine(inputs.url)}) {}

Result<std::unique_ptr<Watching>> Watching::create(const Inputs& inputs, bool one_clock, const LogSink& log) {
  SubscriberOptions options;
  options.url = inputs.url_of_viewers();
  options.profile = inputs.profile();
  options.trace_every = inputs.trace_every;
  options.credentials = inputs.credentials;
  const TimeUs start_us = steady_now_us();
  std::unique_ptr<Watching> made(new Watching(inputs, one_clock, start_us));
  if (const auto good = store(made->subscriber_, Subscriber::create(options, log)); !good) return good.error();
  std::promise<Result<void>> ready;
  auto is_ready = ready.get_future();
  made->thread_ = std::thread([w = made.get(), result = std::move(ready)]() mutable {
    const Result<void> prepared = w->prepare();  // On the thread that OpenGL will be used on.
    const bool good = bool{prepared};
    result.set_value(prepared);
    if (good) w->run();
  });
  if (const Result<void> prepared = is_ready.get(); !prepared) return prepared.error();
  return made;
}

void Watching::stop() {
  stopping_ = true;
  if (thread_.joinable()) thread_.join();
}

Watching::Connection Watching::connection() const {
  const std::lock_guard lock(mutex_);
  return connection_;
}

Progress Watching::progress() const {
  const std::lock_guard lock(mutex_);
  const HdrHistogram& h = outcome_.keys;
  const Counts& counts = outcome_.counts;
  return {.keys = counts.keys_received,
          .synthetic = counts.synthetic_received,
          .traced = counts.traced,
          .p50_us = h.percentile(50),
          .p99_us = h.percentile(99)};
}

Result<void> Watching::prepare() {
  if (inputs_.present.empty()) return {};
  const auto size = picture_size_from_text(inputs_.present);
  if (!size) return size.error();
  if (const auto good = store(presenter_, make_presenter(*size)); !good) return good.error();
  outcome_.device = presenter_->device();
  return {};
}

void Watching::run() {
  run_when_woken(kMakingPoses);  // As the viewer does.
  while (!stopping_) {
    const std::vector<ReceivedPose> poses = subscriber_->poll(milliseconds(20));
    const TimeUs taken_us = steady_now_us();
    for (const ReceivedPose& pose : poses) {
      if (presenter_ && &pose != &poses.back()) {  // As the viewer does: a picture of the newest only.
        outcome_.counts.overtaken += counts(pose) ? 1 : 0;
        continue;
      }
      take(pose, taken_us);
    }
    take_traces();
    const Subscriber::Stats stats = subscriber_->stats();
    if (stats.clock_offset_us)
      outcome_.viewer_clock.add({steady_now_us() - start_us_, *stats.clock_offset_us, *stats.clock_error_us});
    const std::lock_guard lock(mutex_);
    connection_ = {stats.state, stats.detail};
    if (stats.rtt_us) outcome_.round_trip_us = stats.rtt_us;
  }
  presenter_.reset();
}

void Watching::take(const ReceivedPose& pose, TimeUs taken_us) {
  const Asset* asset = subscriber_->asset();
  if (asset == nullptr) return;
  // From the second of several on, the wait for the first belongs to the hand over.
  const TimeUs begun_us = std::max(taken_us, steady_now_us());
  const std::uint32_t level = level_from_fraction(*asset, inputs_.lod);
  positions_.resize(std::size_t{level} * 3);
  if (subscriber_->epoch() != reconstructed_epoch_) reconstructor_.reset();
  reconstructed_epoch_ = subscriber_->epoch();
  reconstructor_.update(*asset);
  reconstructor_.rebuild(pose.coefficients, pose.channels, asset->rank, level, positions_);
  const TimeUs rebuilt_us = steady_now_us();
  if (first_surface_us_ == 0) first_surface_us_ = rebuilt_us - start_us_;
  if (whole_asset_us_ == 0 && asset->complete()) whole_asset_us_ = rebuilt_us - start_us_;
  if (presenter_) presenter_->present(*asset, level, positions_);
  const TimeUs shown_us = presenter_ ? steady_now_us() : rebuilt_us;
  if (first_picture_us_ == 0) first_picture_us_ = shown_us - start_us_;
  if (!counts(pose)) return;
  const Subscriber::Stats stats = subscriber_->stats();  // After the last stamp: it takes its time, too.
  if (counted_from_us_ == 0) {
    counted_from_us_ = shown_us;
    at_begin_ = stats;
  }
  outcome_.vertices_rebuilt = level;
  outcome_.seconds = static_cast<double>(shown_us - counted_from_us_) / 1e6;
  outcome_.kbit_per_s =
      outcome_.seconds > 0 ? static_cast<double>(stats.bytes - at_begin_.bytes) * 8e-3 / outcome_.seconds : 0;
  outcome_.link = link_bytes(static_cast<double>(stats.frames - at_begin_.frames),
                             static_cast<double>(stats.bytes - at_begin_.bytes));
  outcome_.recalled = stats.recalled - at_begin_.recalled;
  outcome_.memory_bytes = stats.memory_bytes;
  outcome_.reconnects = stats.reconnects - at_begin_.reconnects;
  outcome_.counts.superseded = stats.dropped - at_begin_.dropped;
  if (!one_clock_) {  // Only gaps in the keys' numbers of a sender elsewhere are known.
    const std::uint64_t missed = stats.missed - at_begin_.missed;
    outcome_.counts.keys_lost = missed - std::min(missed, outcome_.counts.superseded);
  }
  count(pose, shown_us);
  Received received{pose.envelope, pose.arrival_us, pose.decoded_us, begun_us, rebuilt_us, shown_us, std::nullopt};
  if (stats.clock_offset_us) received.clock = ViewerClock{*stats.clock_offset_us, *stats.clock_error_us};
  timeline_.add(received);
}

bool Watching::counts(const ReceivedPose& pose) const {
  const TimeUs from_us = from_us_, until_us = until_us_, capture_us = pose.envelope.capture_us;
  return from_us != 0 && capture_us >= from_us && (until_us == 0 || capture_us < until_us);
}

void Watching::count(const ReceivedPose& pose, TimeUs shown_us) {
  const Envelope& head = pose.envelope;
  const bool key = head.kind == FrameKind::kKey || head.kind == FrameKind::kJoin || head.step.at == head.step.of;
  const std::lock_guard lock(mutex_);
  Counts& counts = outcome_.counts;
  if (!seen_.insert({head.sequence, key ? std::uint8_t{0} : head.step.byte()}).second) return void(++counts.duplicate);
  if (seen_.size() > 1024) seen_.erase(seen_.begin());
  if (head.capture_us <= newest_capture_us_) ++counts.out_of_order;
  newest_capture_us_ = std::max(newest_capture_us_, head.capture_us);
  ++(key ? counts.keys_received : counts.synthetic_received);
  if (!one_clock_) return;
  age_.show(head.capture_us, shown_us);
  const TimeUs latency_us = shown_us - head.capture_us;
  if (static_cast<double>(latency_us) > inputs_.late_ms * 1000) ++counts.late;
  (key ? outcome_.keys : outcome_.synthetic).add(latency_us);
  Interval& interval = outcome_.intervals.at(shown_us - counted_from_us_);
  (key ? interval.keys : interval.synthetic).add(latency_us);
}

void Watching::take_traces() {
  for (const control::Trace& trace : subscriber_->take_traces()) {
    if (from_us_ == 0) continue;
    if (trace.broker_clock)
      outcome_.sender_clock.add(
          {steady_now_us() - start_us_, trace.broker_clock->offset_us, trace.broker_clock->error_us});
    timeline_.add(trace);
  }
  const std::vector<StagedPose> staged = timeline_.take();
  const std::lock_guard lock(mutex_);
  for (const StagedPose& pose : staged) {
    ++outcome_.counts.traced;
    if (outcome_.samples.size() < kMaxStagedPoses) outcome_.samples.push_back(pose);
  }
}

void Watching::report_to(Outcome& outcome) {
  take_traces();
  std::swap(outcome, outcome_);
  const Subscriber::Stats stats = subscriber_->stats();
  outcome.counts.trace_incomplete = timeline_.incomplete();
  if (first_surface_us_ != 0) outcome.first_surface_us = first_surface_us_;
  if (whole_asset_us_ != 0) outcome.whole_asset_us = whole_asset_us_;
  if (first_picture_us_ != 0 && !outcome.device.empty()) outcome.first_picture_us = first_picture_us_;
  outcome.age_us = age_.ages_us();
  outcome.asset_bytes = stats.asset_bytes_total;
  if (const Asset* asset = subscriber_->asset()) {
    outcome.vertices = asset->vertex_count;
    outcome.rank = static_cast<int>(asset->rank);
  }
  if (const auto& info = subscriber_->info()) outcome.key_rate_hz = info->key_rate_hz;
}

}  // namespace eigencast::latency
