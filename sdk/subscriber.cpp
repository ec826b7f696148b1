// SPDX-License-Identifier: MIT
#include "sdk/subscriber.h"

#include <algorithm>
#include <condition_variable>
#include <mutex>
#include <tuple>
#include <utility>

#include "sdk/receiver.h"
#include "sdk/surfaces.h"

namespace eigencast {

using std::chrono::milliseconds;

class Subscriber::Impl {
 public:
  Impl(const BrokerUrl& url, std::string cache_dir, const BrokerConnection::Request& request)
      : url_(url),
        surfaces_(
            url, std::move(cache_dir), [this] { wake(); }, request.log),
        receiver_(url, request, [this] { wake(); }) {}

  std::vector<control::Trace> take_traces() { return receiver_.take_traces(); }

  std::vector<ReceivedPose> poll(milliseconds timeout) {
    {
      std::unique_lock lock(wake_mutex_);
      woken_.wait_for(lock, timeout, [&] { return has_news_; });
      has_news_ = false;
    }
    Receiver::News news = receiver_.take();
    if (news.declined) info_.reset();
    if (news.info) {
      info_ = std::move(*news.info);
      if (surfaces_.announce(*info_)) held_.reset();
    }
    if (surfaces_.add_object()) wake();
    std::vector<ReceivedPose> poses;
    if (held_ && surfaces_.is_shown(held_->envelope.epoch)) {
      deliver(std::move(*held_), poses);
      held_.reset();
    }
    for (ReceivedPose& pose : news.poses) {
      if (surfaces_.is_shown(pose.envelope.epoch)) {
        deliver(std::move(pose), poses);
      } else if (surfaces_.is_pending(pose.envelope.epoch)) {
        held_ = std::move(pose);
      }
    }
    return poses;
  }

  const Asset* asset() const { return surfaces_.asset(); }
  std::uint32_t epoch() const { return surfaces_.epoch(); }
  const std::optional<control::StreamInfo>& info() const { return info_; }

  Stats stats() const {
    const Receiver::Condition c = receiver_.condition();
    const AssetFetcher::Stats fetched = surfaces_.fetched();
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
    s.asset_bytes_total = surfaces_.total_bytes();
    std::tie(s.state, s.detail) = state_of(c, fetched.trouble);
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

  /// Rows that did not come become those of the rest pose; channels beyond x, y, z zero.
  void deliver(ReceivedPose pose, std::vector<ReceivedPose>& poses) const {
    // A pose brings its own layout: what was announced with it may not be what is announced now.
    const Asset& asset = *surfaces_.asset();
    if (pose.channels < 3 || pose.coefficients.size() != std::size_t{asset.rank} * pose.channels) return;
    for (std::size_t band = 0; band < pose.band_ends.size(); ++band) {
      if (pose.envelope.bands.has(band)) continue;
      std::vector<double>& C = pose.coefficients.edit();
      const auto [first, end] = band_range(pose.band_ends, band);
      for (std::size_t row = first; row < end; ++row) std::copy_n(&asset.rest[3 * row], 3, &C[row * pose.channels]);
    }
    poses.push_back(std::move(pose));
  }

  std::pair<State, std::string> state_of(const Receiver::Condition& c, const std::string& fetch_trouble) const {
    const std::string where = url_.origin() + "/" + url_.stream;
    if (c.refused) return {State::kRefused, c.trouble};
    if (!c.open) return {c.ever_open ? State::kLost : State::kConnecting, c.trouble};
    if (c.declined) return {State::kRefused, c.notice};
    if (!info_) return {State::kConnecting, c.notice.empty() ? "connected, asking for " + url_.stream : c.notice};
    if (auto damage = surfaces_.damage(); !damage.empty()) return {State::kRefused, std::move(damage)};
    if (info_->state == control::StreamInfo::State::kWaiting)
      return {State::kWaiting, "waiting for a sender at " + where};
    if (info_->state == control::StreamInfo::State::kStalled)
      return {State::kStalled, "stalled: the sender of " + where + " is gone, its last pose is held"};
    const auto progress = surfaces_.progress();
    if (progress < Surfaces::Progress::kDrawable)
      return {State::kDownloading, fetch_trouble.empty() ? "downloading the surface" : fetch_trouble};
    if (progress != Surfaces::Progress::kFinished)
      return {State::kLive, fetch_trouble.empty() ? std::string("live, downloading detail")
                                                  : "live, detail is late: " + fetch_trouble};
    return {State::kLive, c.notice.empty() ? "live" : c.notice};
  }

  const BrokerUrl url_;

  std::mutex wake_mutex_;
  std::condition_variable woken_;
  bool has_news_ = false;  ///< GUARDED_BY(wake_mutex_)

  // For the caller's thread alone.
  std::optional<control::StreamInfo> info_;
  std::optional<ReceivedPose> held_;  ///< The newest pose of the surface that is on its way.

  // Last, so that they end first: they call wake().
  Surfaces surfaces_;
  Receiver receiver_;
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
  BrokerConnection::Request request{{url->stream, profile}, options.trace_every, options.declined_retry, log};
  return std::unique_ptr<Subscriber>(
      new Subscriber(std::make_unique<Impl>(*url, std::move(options.cache_dir), request)));
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
