// SPDX-License-Identifier: MIT
#include "sdk/receiver.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "common/wire/limits.h"
#include "sdk/broker.h"

namespace eigencast {
namespace {

using std::chrono::milliseconds;

constexpr std::size_t kMaxPoses = 64;
constexpr std::size_t kMaxTraces = 256;
constexpr TimeUs kNoticeUs = 3'000'000;
constexpr TimeUs kLateEveryUs = 250'000;

/// Nothing: there is none.
std::optional<TimeUs> retry_at_us(milliseconds wait) {
  return wait.count() > 0 ? std::optional(steady_now_us() + TimeUs{wait.count()} * 1000) : std::nullopt;
}

}  // namespace

Receiver::Receiver(const BrokerUrl& url, BrokerConnection::Request request, std::function<void()> wake)
    : url_(url), request_(std::move(request)), wake_(std::move(wake)) {
  condition_.trouble = "connecting to " + url_.origin();
  connection_ = BrokerConnection::join(url_, request_, *this);
}

Receiver::News Receiver::take() {
  std::unique_lock lock(mutex_);
  const bool crowded_out = std::exchange(crowded_out_, false), misplaced = std::exchange(misplaced_, false);
  if (crowded_out || misplaced) {
    lock.unlock();
    const auto found = misplaced ? located(url_) : std::nullopt;
    if (crowded_out || found) {
      connection_->leave(*this);
      if (found) {
        url_ = *found;
        request_.subscribe.stream = url_.stream;
      }
      connection_ = BrokerConnection::join(url_, request_, *this);
    }
    lock.lock();
  }
  return std::exchange(news_, {});
}

std::vector<control::Trace> Receiver::take_traces() {
  const std::lock_guard lock(mutex_);
  std::vector<control::Trace> traces(traces_.begin(), traces_.end());
  traces_.clear();
  return traces;
}

Receiver::Condition Receiver::condition() const {
  const std::lock_guard lock(mutex_);
  Condition condition = condition_;
  condition.counts = decoder_.counts();
  condition.counts.rejected += unreadable_;
  if (steady_now_us() > notice_until_us_) condition.notice.clear();
  return condition;
}

void Receiver::on_open(const BrokerUrl& broker) {
  std::unique_lock lock(mutex_);
  news_.broker = broker;
  if (condition_.ever_open) ++condition_.reconnects;
  condition_.open = condition_.ever_open = true;
  condition_.refused = condition_.declined = false;
  condition_.trouble.clear();
  condition_.retry_at_us.reset();
  condition_.clock.reset();
  moment_.reset();
  kept_.reset();
  decoder_.restart();
  forget_memory();
  lock.unlock();
  wake_();
}

void Receiver::forget_memory() {
  decoder_.set_memory(std::nullopt);
  segments_.clear();
  news_.memory.reset();
}

void Receiver::on_memory(const control::Remember& memory) {
  std::unique_lock lock(mutex_);
  const bool fits =
      memory.kept <= segments_.size() && memory.kept + memory.segments.size() <= limits::kMaxMemorySegments;
  std::vector<std::string> segments(segments_.begin(), segments_.begin() + (fits ? std::ptrdiff_t{memory.kept} : 0));
  if (!fits || memory.kept < segments_.size()) forget_memory();
  if (!fits) return;  // A broker that contradicts itself: no memory until it begins anew.
  segments.insert(segments.end(), memory.segments.begin(), memory.segments.end());
  segments_ = std::move(segments);
  news_.memory = {memory.stream, memory.generation, 0, segments_};
  lock.unlock();
  wake_();
}

void Receiver::hold(const control::Remember& memory, const PoseMemory& poses) {
  std::unique_lock lock(mutex_);
  const bool begins = memory.segments.size() <= segments_.size() &&
                      std::equal(memory.segments.begin(), memory.segments.end(), segments_.begin());
  if (!begins || poses.layout() != decoder_.layout()) return;
  decoder_.set_memory(poses);
  lock.unlock();
  connection_->hold(*this, memory.generation);
}

void Receiver::on_down(const Error& why, milliseconds wait) {
  std::unique_lock lock(mutex_);
  condition_.open = condition_.declined = false;
  condition_.refused = why.code == ErrorCode::kRefused || wait.count() == 0;
  misplaced_ = condition_.refused && !condition_.ever_open;
  condition_.trouble = why.message + try_again_in(wait);
  condition_.retry_at_us = retry_at_us(wait);
  lock.unlock();
  wake_();
}

void Receiver::on_info(const control::StreamInfo& info) {
  std::unique_lock lock(mutex_);
  decoder_.set_stream(info);
  is_past_ = info.rewind.has_value();
  if (is_past_) moment_.reset();  // It is in step with nobody.
  if (std::exchange(epoch_, info.epoch) != info.epoch) forget_memory();
  news_.info = info;
  news_.declined = condition_.declined = false;
  condition_.retry_at_us.reset();
  condition_.notice.clear();
  lock.unlock();
  wake_();
}

void Receiver::on_trace(const control::Trace& trace) {
  const std::lock_guard lock(mutex_);
  if (traces_.size() == kMaxTraces) traces_.pop_front();
  traces_.push_back(trace);
}

void Receiver::on_notice(const control::Notice& notice) {
  std::unique_lock lock(mutex_);
  condition_.dropped += notice.frames_dropped;
  condition_.notice = notice.message;
  notice_until_us_ = steady_now_us() + kNoticeUs;
  lock.unlock();
  log(request_.log, LogLevel::kInfo, notice.message);
}

void Receiver::on_error(const control::ErrorMessage& error, bool declined) {
  const std::string text = "the broker says: " + error.message + " (" + error.code + ")" +
                           (declined ? try_again_in(request_.declined_retry) : std::string());
  std::unique_lock lock(mutex_);
  if (declined) {
    news_.info.reset();
    news_.declined = condition_.declined = true;
    condition_.retry_at_us = retry_at_us(request_.declined_retry);
  }
  condition_.notice = text;
  notice_until_us_ = std::numeric_limits<TimeUs>::max();
  lock.unlock();
  log(request_.log, LogLevel::kError, text);
  wake_();
}

void Receiver::on_crowded_out() {
  std::unique_lock lock(mutex_);
  crowded_out_ = true;
  lock.unlock();
  wake_();
}

void Receiver::on_clock(const ClockOffset::Estimate& clock) {
  const std::lock_guard lock(mutex_);
  condition_.clock = clock;
}

void Receiver::on_moment(const control::Moment& moment) {
  const std::lock_guard lock(mutex_);
  moment_ = moment;
}

std::optional<SharedMoment> Receiver::moment() const {
  const std::lock_guard lock(mutex_);
  if (!moment_ || !condition_.clock) return std::nullopt;
  return SharedMoment{bounded_time(bounded_time(moment_->lag_us) - bounded_time(condition_.clock->offset_us)),
                      bounded_time(moment_->delay_us)};
}

void Receiver::report_late(TimeUs needed_lag_us) {
  std::unique_lock lock(mutex_);
  const TimeUs now = steady_now_us();
  if (request_.subscribe.sync.empty() || !condition_.clock || now - late_said_us_ < kLateEveryUs) return;
  late_said_us_ = now;
  const TimeUs offset_us = bounded_time(condition_.clock->offset_us);
  lock.unlock();
  say(control::Late{name(), bounded_time(needed_lag_us) + offset_us});
}

void Receiver::on_history(const control::History& history) {
  std::unique_lock lock(mutex_);
  const std::uint64_t refusals = (kept_ ? kept_->refusals : 0) + (history.code.empty() ? 0 : 1);
  const std::string trouble = history.code.empty() ? std::string() : history.message + " (" + history.code + ")";
  kept_ = Rewind::Kept{history.now_us, steady_now_us(), history.spans, trouble, refusals};
  lock.unlock();
  wake_();
}

std::optional<Rewind::Kept> Receiver::kept() const {
  const std::lock_guard lock(mutex_);
  return kept_;
}

void Receiver::on_frame(const std::optional<FrameView>& frame, std::size_t bytes, TimeUs now) {
  const auto shows = [&]() -> Result<bool> {
    const std::lock_guard lock(mutex_);
    ++condition_.frames;
    condition_.bytes += bytes;
    if (frame) return decode(*frame, now);
    ++unreadable_;
    return false;
  }();
  if (!shows) log(request_.log, LogLevel::kWarning, "frame not decoded: " + shows.error().message);
  if (shows && *shows) wake_();
}

Result<bool> Receiver::decode(const FrameView& frame, TimeUs now) {
  const Result<const Key*> key = decoder_.decode(frame);
  if (!key) return key.error();
  if (frame.envelope.is_recalled() && frame.envelope.kind == FrameKind::kKey) ++condition_.recalled;
  if (*key == nullptr) return false;
  if (news_.poses.size() == kMaxPoses) news_.poses.pop_front();
  const CoefficientLayout& layout = decoder_.layout();
  ReceivedPose pose{frame.envelope,  now, steady_now_us(), decoder_.coefficients(**key), layout.channels,
                    layout.band_ends};
  Envelope& head = pose.envelope;
  head.bands = (*key)->bands;
  if (head.is_ahead()) {
    head.kind = FrameKind::kStep;
    head.capture_us = shown_us(frame.envelope);
    head.flags = 0;
  }
  if (!is_past_) condition_.latency_us.add(now - head.capture_us);
  if (const Key* next = decoder_.take_ahead())
    pose.next = {decoder_.newest_capture_us(), next->bands, decoder_.coefficients(*next)};
  news_.poses.push_back(std::move(pose));
  return true;
}

}  // namespace eigencast
