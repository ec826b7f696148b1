// SPDX-License-Identifier: MIT
#include "sdk/subscriber.h"

#include <algorithm>
#include <condition_variable>
#include <deque>
#include <limits>
#include <mutex>
#include <thread>
#include <tuple>
#include <utility>

#include "common/asset/format.h"
#include "common/net/clock_offset.h"
#include "common/net/guarded_run.h"
#include "common/net/websocket.h"
#include "common/wire/limits.h"
#include "sdk/asset_fetcher.h"
#include "sdk/frame_decoder.h"
#include "sdk/retry_text.h"

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

/// A decoded pose on its way to the caller: absent bands are filled in there, where the asset is.
struct Arrival {
  Envelope envelope;
  TimeUs arrival_us = 0;
  TimeUs decoded_us = 0;
  Key key;
  CoefficientLayout layout;
};

/// The network's side: connection, control messages, chain, acknowledgements. Its results wait under a lock for poll().
class Receiver {
 public:
  struct News {
    std::deque<Arrival> poses;                ///< At most kMaxPoses, newest kept.
    std::optional<control::StreamInfo> info;  ///< Set when it changed since the last take.
    bool declined = false;                    ///< The subscription was refused since then; no info came after it.
  };
  struct Condition {
    bool open = false, ever_open = false, refused = false;
    bool declined = false;  ///< Connected, but the broker does not give us the stream; it is asked again.
    std::string trouble;    ///< Of the connection; empty while all is well.
    std::string notice;     ///< What the broker said last.
    FrameDecoder::Counts counts;
    std::uint64_t bytes = 0;
    std::uint64_t reconnects = 0;
    std::uint64_t skipped = 0;
    std::optional<ClockOffset::Estimate> clock;
    Histogram latency_us;
  };

  Receiver(BrokerUrl url, Profile profile, std::uint32_t trace_every, milliseconds declined_retry,
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
      guarded_run([this] { tick(); },
                  [this](const std::string& what) { eigencast::log(log_, LogLevel::kError, what); });
    });
  }

  ~Receiver() {
    {
      const std::lock_guard lock(mutex_);
      stopping_ = true;
    }
    stop_.notify_all();
    ticker_.join();
    socket_->stop();
  }

  News take() {
    const std::lock_guard lock(mutex_);
    News news = std::move(news_);
    news_ = {};
    return news;
  }

  std::vector<control::Trace> take_traces() {
    const std::lock_guard lock(mutex_);
    std::vector<control::Trace> traces(traces_.begin(), traces_.end());
    traces_.clear();
    return traces;
  }

  Condition condition() const {
    const std::lock_guard lock(mutex_);
    Condition condition = condition_;
    condition.counts = decoder_.counts();
    condition.counts.rejected += unparsed_;
    condition.clock = clock_.estimate();
    if (steady_now_us() > notice_until_us_) condition.notice.clear();
    return condition;
  }

 private:
  void on_open() {
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

  void on_down(const Error& why, milliseconds wait) {
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

  void on_text(std::string_view text) {
    auto message = control_from_text(text);
    if (!message) {
      if (message.error().code != ErrorCode::kUnsupported)
        log(log_, LogLevel::kWarning, "from the broker: " + message.error().message);
      return;
    }
    std::visit([this](const auto& m) { on_message(m); }, *message);
  }

  template <typename Message>
  void on_message(const Message&) {}  // What concerns senders only.

  void on_message(const control::StreamInfo& m) {
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

  void on_message(const control::Trace& m) {
    const std::lock_guard lock(mutex_);
    if (traces_.size() == kMaxTraces) traces_.pop_front();
    traces_.push_back(m);
  }

  void on_message(const control::Ping& m) { send(text_from_control(control::Pong{m.id, m.time_us, steady_now_us()})); }

  void on_message(const control::Pong& m) {
    const std::lock_guard lock(mutex_);
    clock_.add(m.time_us, m.peer_time_us, steady_now_us());
  }

  void on_message(const control::Notice& m) {
    {
      const std::lock_guard lock(mutex_);
      condition_.skipped += m.skipped_frames;
      condition_.notice = m.message;
      notice_until_us_ = steady_now_us() + kNoticeUs;
    }
    log(log_, LogLevel::kInfo, m.message);
  }

  void on_message(const control::ErrorMessage& m) {
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

  void on_message(const control::Bye& m) {
    {
      const std::lock_guard lock(mutex_);
      socket_->hold_off(milliseconds(m.retry_after_ms));
    }
    log(log_, LogLevel::kInfo, "the broker leaves: " + m.reason);
  }

  void on_binary(ByteView bytes) {
    const TimeUs now = steady_now_us();
    bool news = false;
    std::string trouble;
    {
      const std::lock_guard lock(mutex_);
      condition_.bytes += bytes.size();
      const auto frame = parse_frame(bytes);
      if (!frame) {
        ++unparsed_;
        trouble = frame.error().message;
      } else {
        // Received is received: also what cannot be decoded no longer fills the link.
        ack_ = control::Ack::Item{frame->envelope.stream_id, frame->envelope.sequence, frame->envelope.step.byte()};
        auto pose = decoder_.decode(*frame);
        if (!pose) {
          trouble = pose.error().message;
        } else if (*pose) {
          condition_.latency_us.add(now - frame->envelope.capture_us);
          if (news_.poses.size() == kMaxPoses) news_.poses.pop_front();
          news_.poses.push_back({frame->envelope, now, steady_now_us(), std::move(**pose), decoder_.layout()});
          news = true;
        }
      }
    }
    if (!trouble.empty()) log(log_, LogLevel::kWarning, "frame not decoded: " + trouble);
    if (news) wake_();
    const std::lock_guard lock(mutex_);  // After the pose is on its way to who waits for it.
    if (ack_ && now - last_ack_us_ >= kAckIntervalUs) acknowledge(now);
  }

  /// REQUIRES: mutex_ is held and ack_ is set.
  void acknowledge(TimeUs now) {
    (void)socket_->send_text(text_from_control(control::Ack{{*ack_}, now}));  // A lost one is made up for by the next.
    ack_.reset();
    last_ack_us_ = now;
  }

  void send(std::string text) {
    const std::lock_guard lock(mutex_);
    (void)socket_->send_text(std::move(text));
  }

  /// Acknowledges what the last frame of a burst left over, and pings.
  void tick() {
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

  const BrokerUrl url_;
  const Profile profile_;
  const std::uint32_t trace_every_;
  const milliseconds declined_retry_;
  const std::function<void()> wake_;
  const LogSink log_;

  mutable std::mutex mutex_;
  std::condition_variable stop_;
  // GUARDED_BY(mutex_), all that follows.
  bool stopping_ = false;
  FrameDecoder decoder_;
  ClockOffset clock_;
  bool trace_asked_ = false;           ///< On this connection.
  std::deque<control::Trace> traces_;  ///< At most kMaxTraces, newest kept.
  News news_;
  Condition condition_;
  TimeUs notice_until_us_ = 0;
  std::uint64_t unparsed_ = 0;
  std::optional<control::Ack::Item> ack_;  ///< Newest frame that is not acknowledged yet.
  TimeUs last_ack_us_ = 0, last_ping_us_ = 0;
  std::uint64_t ping_id_ = 0;
  std::optional<TimeUs> ask_again_at_us_;
  std::unique_ptr<WebSocket> socket_;

  std::thread ticker_;
};

/// One epoch's surface as far as it has come.
struct SurfaceSlot {
  std::string asset;  ///< 64 hex digits.
  std::uint32_t epoch = 0;
  StreamFormat format;                ///< Of the poses, as announced last for this asset.
  std::optional<AssetReader> reader;  ///< From the manifest on.
  std::size_t next_chunk = 0;
  std::uint64_t total_bytes = 0;
  std::string damage;  ///< Why it can never be drawn; empty if it may.

  bool drawable() const { return next_chunk > 0; }
  bool finished() const { return reader && next_chunk == reader->chunks().size(); }
};

}  // namespace

class Subscriber::Impl {
 public:
  Impl(const BrokerUrl& url, Profile profile, std::uint32_t trace_every, milliseconds declined_retry,
       std::string cache_dir, const LogSink& log)
      : url_(url),
        log_(log),
        fetcher_(
            url, std::move(cache_dir), [this] { wake(); }, log) {
    receiver_.emplace(
        url, profile, trace_every, declined_retry, [this] { wake(); }, log);
  }

  std::vector<control::Trace> take_traces() { return receiver_->take_traces(); }

  std::vector<ReceivedPose> poll(milliseconds timeout) {
    {
      std::unique_lock lock(wake_mutex_);
      woken_.wait_for(lock, timeout, [&] { return has_news_; });
      has_news_ = false;
    }
    Receiver::News news = receiver_->take();
    if (news.declined) info_.reset();
    if (news.info) apply(std::move(*news.info));
    add_object();
    std::vector<ReceivedPose> poses;
    if (held_ && is_shown(held_->envelope.epoch)) {
      deliver(*held_, poses);
      held_.reset();
    }
    for (Arrival& arrival : news.poses) {
      if (is_shown(arrival.envelope.epoch)) {
        deliver(arrival, poses);
      } else if (pending_ && arrival.envelope.epoch == pending_->epoch) {
        held_ = std::move(arrival);
      }
    }
    return poses;
  }

  const Asset* asset() const { return shown_ ? &shown_->reader->asset() : nullptr; }
  std::uint32_t epoch() const { return shown_ ? shown_->epoch : 0; }
  const std::optional<control::StreamInfo>& info() const { return info_; }

  Stats stats() const {
    const Receiver::Condition c = receiver_->condition();
    const AssetFetcher::Stats fetched = fetcher_.stats();
    Stats s;
    s.keys = c.counts.keys;
    s.synthetic = c.counts.synthetic;
    s.joins = c.counts.joins;
    s.rejected = c.counts.rejected;
    s.missed = c.counts.missed;
    s.bytes = c.bytes;
    s.skipped = c.skipped;
    s.reconnects = c.reconnects;
    s.latency_us = c.latency_us;
    if (c.clock) {
      s.clock_offset_us = c.clock->offset_us;
      s.clock_error_us = c.clock->error_us;
      s.rtt_us = c.clock->rtt_us;
    }
    s.asset_bytes_downloaded = fetched.downloaded_bytes;
    s.asset_bytes_cached = fetched.cached_bytes;
    s.asset_bytes_total = latest() ? latest()->total_bytes : 0;
    std::tie(s.state, s.detail) = state_of(c, fetched);
    return s;
  }

 private:
  void wake() {
    {
      const std::lock_guard lock(wake_mutex_);
      has_news_ = true;
    }
    woken_.notify_all();
  }

  /// The surface of the newest epoch: what is being fetched, else what is shown.
  const SurfaceSlot* latest() const { return pending_ ? pending_.get() : shown_.get(); }
  SurfaceSlot* latest() { return pending_ ? pending_.get() : shown_.get(); }
  bool is_shown(std::uint32_t epoch) const { return shown_ && shown_->epoch == epoch; }

  void apply(control::StreamInfo info) {
    info_ = std::move(info);
    if (info_->state == control::StreamInfo::State::kWaiting || info_->asset.empty()) return;
    if (goes_on(latest())) return adopt(*latest());
    held_.reset();
    if (goes_on(shown_.get())) {  // Back to what is shown before its successor could be.
      pending_.reset();
    } else {  // Also where this very surface could not be shown before: what was wrong may have been put right.
      pending_ = std::make_unique<SurfaceSlot>();
      pending_->asset = info_->asset;
    }
    adopt(*latest());
    ask();
  }

  /// Whether the slot is of the surface announced last and nothing is wrong with it.
  bool goes_on(const SurfaceSlot* slot) const {
    return slot != nullptr && slot->asset == info_->asset && slot->damage.empty();
  }

  /// The slot's surface is announced (again): the same asset may come with poses of another format.
  void adopt(SurfaceSlot& slot) {
    slot.epoch = info_->epoch;
    slot.format = info_->format;
    check_format_of(slot);
  }

  /// Damages the slot if the announced poses cannot deform its surface; true if they can, as far as is known.
  bool check_format_of(SurfaceSlot& slot) {
    if (!slot.reader) return true;
    const std::uint32_t rank = slot.reader->asset().rank;
    if (rank != slot.format.rows) {
      damage(slot,
             fail(ErrorCode::kCorrupt, "its basis has " + std::to_string(rank) + " columns, the stream's poses have " +
                                           std::to_string(slot.format.rows)));
    } else if (slot.format.channels < 3) {
      damage(slot, fail(ErrorCode::kUnsupported, "its poses have fewer than three channels"));
    }
    return slot.damage.empty();
  }

  /// Asks for all that the latest surface still needs.
  void ask() {
    SurfaceSlot& slot = *latest();
    if (!slot.damage.empty()) return;
    std::vector<AssetFetcher::Object> objects;
    if (!slot.reader) {
      const auto id = Sha256::from_hex(slot.asset);
      if (!id) return damage(slot, fail(ErrorCode::kCorrupt, "\"" + slot.asset + "\" is not an asset's id"));
      objects.push_back({*id, limits::kMaxAssetObjectBytes});
    } else {
      const auto& chunks = slot.reader->chunks();
      for (std::size_t i = slot.next_chunk; i < chunks.size(); ++i) objects.push_back({chunks[i].id, chunks[i].bytes});
    }
    fetcher_.ask(std::move(objects));
  }

  void damage(SurfaceSlot& slot, const Error& why) {
    slot.damage = "the stream's surface cannot be shown: " + why.message;
    log(log_, LogLevel::kError, slot.damage);
    fetcher_.ask({});
  }

  /// Verifies and applies at most one object, so that no poll takes long.
  void add_object() {
    SurfaceSlot* slot = latest();
    if (!slot || !slot->damage.empty() || slot->finished()) return;
    const auto bytes = fetcher_.take();
    if (!bytes) return;
    wake();  // There may be another one ready.
    if (!slot->reader) {
      read_manifest(*slot, *bytes);
      return;
    }
    if (auto added = slot->reader->add_chunk(slot->next_chunk, *bytes); !added) return damage(*slot, added.error());
    ++slot->next_chunk;
    if (pending_) shown_ = std::move(pending_);
  }

  void read_manifest(SurfaceSlot& slot, ByteView bytes) {
    auto reader = AssetReader::from_manifest(*Sha256::from_hex(slot.asset), bytes);
    if (!reader) return damage(slot, reader.error());
    slot.total_bytes = bytes.size();
    for (const auto& chunk : reader->chunks()) slot.total_bytes += chunk.bytes;
    slot.reader = std::move(*reader);
    if (check_format_of(slot)) ask();
  }

  void deliver(const Arrival& arrival, std::vector<ReceivedPose>& poses) const {
    // A pose brings its own layout: what was announced with it may not be what is announced now.
    if (arrival.layout.rows != shown_->reader->asset().rank || arrival.layout.channels < 3) return;
    ReceivedPose pose;
    pose.envelope = arrival.envelope;
    pose.envelope.bands = arrival.key.bands;  // A step's own envelope has none.
    pose.arrival_us = arrival.arrival_us;
    pose.decoded_us = arrival.decoded_us;
    pose.channels = arrival.layout.channels;
    pose.coefficients = coefficients_from_key(arrival.layout, arrival.key);
    fill_absent_bands(arrival, pose.coefficients);
    poses.push_back(std::move(pose));
  }

  /// Rows that did not come read as those of the rest pose; channels beyond x, y, z as zero.
  void fill_absent_bands(const Arrival& arrival, std::vector<double>& C) const {
    const std::vector<double>& rest = shown_->reader->asset().rest;
    const std::size_t channels = arrival.layout.channels;
    for (std::size_t band = 0; band < arrival.layout.band_ends.size(); ++band) {
      if (arrival.key.bands & (1u << band)) continue;
      const std::size_t first = band == 0 ? 0 : arrival.layout.band_ends[band - 1];
      for (std::size_t row = first; row < arrival.layout.band_ends[band]; ++row)
        for (std::size_t axis = 0; axis < std::min<std::size_t>(3, channels); ++axis)
          C[row * channels + axis] = rest[row * 3 + axis];
    }
  }

  std::pair<State, std::string> state_of(const Receiver::Condition& c, const AssetFetcher::Stats& fetched) const {
    const std::string where = url_.origin() + "/" + url_.stream;
    if (c.refused) return {State::kRefused, c.trouble};
    if (!c.open) return {c.ever_open ? State::kLost : State::kConnecting, c.trouble};
    if (c.declined) return {State::kRefused, c.notice};
    if (!info_) return {State::kConnecting, c.notice.empty() ? "connected, asking for " + url_.stream : c.notice};
    if (latest() && !latest()->damage.empty()) return {State::kRefused, latest()->damage};
    if (info_->state == control::StreamInfo::State::kWaiting)
      return {State::kWaiting, "waiting for a sender at " + where};
    if (info_->state == control::StreamInfo::State::kStalled)
      return {State::kStalled, "stalled: the sender of " + where + " is gone, its last pose is held"};
    if (pending_ || !shown_)
      return {State::kDownloading, fetched.trouble.empty() ? "downloading the surface" : fetched.trouble};
    if (!shown_->finished())
      return {State::kLive, fetched.trouble.empty() ? std::string("live, downloading detail")
                                                    : "live, detail is late: " + fetched.trouble};
    return {State::kLive, c.notice.empty() ? "live" : c.notice};
  }

  const BrokerUrl url_;
  const LogSink log_;

  std::mutex wake_mutex_;
  std::condition_variable woken_;
  bool has_news_ = false;  ///< GUARDED_BY(wake_mutex_)

  // Of the caller's thread alone.
  std::optional<control::StreamInfo> info_;
  std::unique_ptr<SurfaceSlot> shown_;    ///< Drawable, of epoch().
  std::unique_ptr<SurfaceSlot> pending_;  ///< Of the newest epoch, until its first chunk is in.
  std::optional<Arrival> held_;           ///< The newest pose of pending_.

  // Last, so that they end first: their threads call wake().
  AssetFetcher fetcher_;
  std::optional<Receiver> receiver_;
};

Subscriber::Subscriber(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Subscriber::~Subscriber() = default;

Result<std::unique_ptr<Subscriber>> Subscriber::create(SubscriberOptions options, LogSink log) {
  auto url = parse_broker_url(options.url);
  if (!url) return url.error();
  if (const auto good = complete_credentials(*url, options.credentials, log); !good) return good.error();
  if (auto name = check_stream_name(url->stream); !name)
    return in_context("stream name in \"" + url->shown() + "\"", name.error());
  Profile profile;
  if (options.profile) {
    profile = *options.profile;
  } else {
    auto parsed = profile_from_query(url->query);
    if (!parsed) return parsed.error();
    profile = *parsed;
  }
  return std::unique_ptr<Subscriber>(new Subscriber(std::make_unique<Impl>(
      *url, profile, options.trace_every, options.declined_retry, std::move(options.cache_dir), log)));
}

std::vector<ReceivedPose> Subscriber::poll(milliseconds timeout) {
  return impl_->poll(timeout);
}
const Asset* Subscriber::asset() const {
  return impl_->asset();
}
std::uint32_t Subscriber::epoch() const {
  return impl_->epoch();
}
const std::optional<control::StreamInfo>& Subscriber::info() const {
  return impl_->info();
}
Subscriber::Stats Subscriber::stats() const {
  return impl_->stats();
}
std::vector<control::Trace> Subscriber::take_traces() {
  return impl_->take_traces();
}

}  // namespace eigencast
