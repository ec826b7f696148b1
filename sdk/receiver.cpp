// SPDX-License-Identifier: MIT
#include "sdk/receiver.h"

#include <limits>
#include <utility>
#include <variant>

#include "common/net/guarded_run.h"
#include "sdk/broker_text.h"

namespace eigencast {
namespace {

using std::chrono::milliseconds;

constexpr std::size_t kMaxPoses = 64;
constexpr std::size_t kMaxTraces = 256;
constexpr TimeUs kAckIntervalUs = 33'000;
constexpr TimeUs kPingIntervalUs = 250'000;
constexpr milliseconds kTick{40};
/// What a notice says is no longer news after so long.
constexpr TimeUs kNoticeUs = 3'000'000;

}  // namespace

Receiver::Receiver(BrokerUrl url, Profile profile, std::uint32_t trace_every, milliseconds declined_retry,
                   std::function<void()> wake, LogSink log)
    : url_(std::move(url)),
      profile_(profile),
      trace_every_(trace_every),
      declined_retry_(declined_retry),
      wake_(std::move(wake)),
      log_(std::move(log)) {
  condition_.trouble = "connecting to " + url_.origin();
  WebSocketOptions options;
  options.url = url_;
  options.target = "/v1/subscribe/" + url_.stream + "?" + query_from_profile(profile);
  WebSocketEvents events;
  events.on_open = [this] { on_open(); };
  events.on_text = [this](std::string_view text) { on_text(text); };
  events.on_binary = [this](ByteView bytes) { on_binary(bytes); };
  events.on_down = [this](const Error& why, milliseconds wait) { on_down(why, wait); };
  {
    const std::lock_guard lock(mutex_);
    socket_ = std::make_unique<WebSocket>(std::move(options), std::move(events), log_);
  }
  ticker_ = std::thread([this] {
    guarded_run([this] { tick(); }, [this](const std::string& what) { eigencast::log(log_, LogLevel::kError, what); });
  });
}

Receiver::~Receiver() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
  }
  stop_.notify_all();
  ticker_.join();
  socket_->stop();
}

Receiver::News Receiver::take() {
  const std::lock_guard lock(mutex_);
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
  condition.counts.rejected += unparsed_;
  condition.clock = clock_.estimate();
  if (steady_now_us() > notice_until_us_) condition.notice.clear();
  return condition;
}

void Receiver::on_open() {
  {
    const std::lock_guard lock(mutex_);
    if (condition_.ever_open) ++condition_.reconnects;
    condition_.open = condition_.ever_open = true;
    condition_.refused = condition_.declined = false;
    ask_again_at_us_.reset();
    condition_.trouble.clear();
    decoder_.restart();
    trace_asked_ = trace_every_ == 0;
    clock_.reset();  // It may be another broker.
    ack_.reset();
    last_ack_us_ = last_ping_us_ = 0;
  }
  wake_();
}

void Receiver::on_down(const Error& why, milliseconds wait) {
  const std::string text = why.message + try_again_in(wait);
  {
    const std::lock_guard lock(mutex_);
    condition_.open = condition_.declined = false;
    ask_again_at_us_.reset();
    condition_.refused = why.code == ErrorCode::kRefused || wait.count() == 0;
    condition_.trouble = text;
  }
  log(log_, LogLevel::kWarning, text);
  wake_();
}

void Receiver::on_text(std::string_view text) {
  if (const auto message = read_control(text, log_)) std::visit([this](const auto& m) { on_message(m); }, *message);
}

void Receiver::on_message(const control::StreamInfo& m) {
  if (m.stream != url_.stream) return;
  {
    const std::lock_guard lock(mutex_);
    decoder_.set_stream(m);
    news_.info = m;
    news_.declined = condition_.declined = false;
    ask_again_at_us_.reset();
    condition_.notice.clear();
    if (!std::exchange(trace_asked_, true))
      (void)socket_->send_text(text_from_control(control::TraceRequest{url_.stream, trace_every_}));
  }
  wake_();
}

void Receiver::on_message(const control::Trace& m) {
  const std::lock_guard lock(mutex_);
  if (traces_.size() == kMaxTraces) traces_.pop_front();
  traces_.push_back(m);
}

void Receiver::on_message(const control::Ping& m) {
  send(text_from_control(control::Pong{m.id, m.time_us, steady_now_us()}));
}

void Receiver::on_message(const control::Pong& m) {
  const std::lock_guard lock(mutex_);
  clock_.add(m.time_us, m.peer_time_us, steady_now_us());
}

void Receiver::on_message(const control::Notice& m) {
  {
    const std::lock_guard lock(mutex_);
    condition_.skipped += m.skipped_frames;
    condition_.notice = m.message;
    notice_until_us_ = steady_now_us() + kNoticeUs;
  }
  log(log_, LogLevel::kInfo, m.message);
}

void Receiver::on_message(const control::ErrorMessage& m) {
  const bool declined = m.stream == url_.stream;
  const std::string text = "the broker says: " + m.message + " (" + m.code + ")" +
                           (declined ? try_again_in(declined_retry_) : std::string());
  {
    const std::lock_guard lock(mutex_);
    if (declined) {
      news_.info.reset();
      news_.declined = condition_.declined = true;
      ask_again_at_us_ = steady_now_us() + TimeUs{declined_retry_.count()} * 1000;
    }
    condition_.notice = text;
    notice_until_us_ = std::numeric_limits<TimeUs>::max();
  }
  log(log_, LogLevel::kError, text);
  wake_();
}

void Receiver::on_message(const control::Bye& m) {
  {
    const std::lock_guard lock(mutex_);
    socket_->hold_off(milliseconds(m.retry_after_ms));
  }
  log(log_, LogLevel::kInfo, "the broker leaves: " + m.reason);
}

void Receiver::on_binary(ByteView bytes) {
  const TimeUs now = steady_now_us();
  const auto news = [&] {
    const std::lock_guard lock(mutex_);
    return take_frame(bytes, now);
  }();
  if (!news) log(log_, LogLevel::kWarning, "frame not decoded: " + news.error().message);
  if (news && *news) wake_();
  const std::lock_guard lock(mutex_);  // After the pose is on its way to who waits for it.
  if (ack_ && now - last_ack_us_ >= kAckIntervalUs) acknowledge(now);
}

Result<bool> Receiver::take_frame(ByteView bytes, TimeUs now) {
  condition_.bytes += bytes.size();
  const auto frame = parse_frame(bytes);
  if (!frame) {
    ++unparsed_;
    return frame.error();
  }
  // Received is received: also what cannot be decoded no longer fills the link.
  ack_ = control::Ack::Item{frame->envelope.stream_id, frame->envelope.sequence, frame->envelope.step.byte()};
  auto pose = decoder_.decode(*frame);
  if (!pose) return pose.error();
  if (!*pose) return false;
  condition_.latency_us.add(now - frame->envelope.capture_us);
  if (news_.poses.size() == kMaxPoses) news_.poses.pop_front();
  news_.poses.push_back({frame->envelope, now, steady_now_us(), std::move(**pose), decoder_.layout()});
  return true;
}

void Receiver::acknowledge(TimeUs now) {
  (void)socket_->send_text(text_from_control(control::Ack{{*ack_}, now}));  // A lost one is made up for by the next.
  ack_.reset();
  last_ack_us_ = now;
}

void Receiver::send(std::string text) {
  const std::lock_guard lock(mutex_);
  (void)socket_->send_text(std::move(text));
}

void Receiver::tick() {
  std::unique_lock lock(mutex_);
  while (!stop_.wait_for(lock, kTick, [&] { return stopping_; })) {
    if (!condition_.open) continue;
    const TimeUs now = steady_now_us();
    if (ack_ && now - last_ack_us_ >= kAckIntervalUs) acknowledge(now);
    if (ask_again_at_us_ && now >= *ask_again_at_us_) {
      ask_again_at_us_.reset();  // The answer, of either kind, says how it goes on.
      (void)socket_->send_text(text_from_control(control::Subscribe{url_.stream, profile_}));
    }
    if (now - last_ping_us_ < kPingIntervalUs) continue;
    last_ping_us_ = now;
    (void)socket_->send_text(text_from_control(control::Ping{++ping_id_, now}));
  }
}

}  // namespace eigencast
