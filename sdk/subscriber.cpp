// SPDX-License-Identifier: MIT
#include "sdk/subscriber.h"

#include <algorithm>
#include <cmath>
#include <condition_variable>
#include <mutex>
#include <tuple>
#include <utility>

#include "common/core/text.h"
#include "sdk/broker.h"
#include "sdk/memory_fetcher.h"
#include "sdk/receiver.h"
#include "sdk/surfaces.h"

namespace eigencast {
namespace {

using std::chrono::milliseconds;

class BrokerSubscriber final : public Subscriber {
 public:
  BrokerSubscriber(const BrokerUrl& url, std::string cache_dir, const BrokerConnection::Request& request,
                   MemoryBudget& memory)
      : url_(url),
        surfaces_(
            std::move(cache_dir), [this] { wake(); }, request.log, memory),
        memories_([this] { wake(); }, request.log, memory),
        receiver_(url, request, [this] { wake(); }) {}

  std::vector<control::Trace> take_traces() override { return receiver_.take_traces(); }
  std::optional<SharedMoment> moment() const override { return receiver_.moment(); }
  void report_late(TimeUs needed_lag_us) override { receiver_.report_late(needed_lag_us); }
  std::optional<Kept> kept() const override { return receiver_.kept(); }
  void ask_kept() override { receiver_.ask_kept(); }
  void seek(TimeUs at_us, double speed, bool next) override { receiver_.seek(at_us, speed, next); }
  void show_present() override { receiver_.show_present(); }

  std::vector<ReceivedPose> poll(milliseconds timeout) override {
    {
      std::unique_lock lock(wake_mutex_);
      woken_.wait_for(lock, timeout, [&] { return has_news_; });
      has_news_ = false;
    }
    Receiver::News news = receiver_.take();
    if (news.broker) surfaces_.use(*news.broker);
    if (news.broker) memories_.use(*news.broker);
    if (news.declined) info_.reset();
    if (news.info) {
      info_ = std::move(*news.info);
      if (surfaces_.announce(*info_)) held_.reset();
    }
    if (news.memory && info_) memories_.want(std::move(*news.memory), *info_);
    if (memories_.add_segments()) receiver_.hold(memories_.wanted(), memories_.poses());
    if (surfaces_.add_object()) wake();
    if (auto asset = surfaces_.take_prepared(); !asset.empty()) receiver_.say_prepared(asset);
    std::vector<ReceivedPose> poses;
    if (held_ && surfaces_.is_shown(held_->envelope.epoch)) {
      deliver(std::move(*held_), poses);
      held_.reset();
    }
    for (ReceivedPose& pose : news.poses) {
      carry_over(pose);
      if (surfaces_.is_shown(pose.envelope.epoch)) {
        deliver(std::move(pose), poses);
      } else if (surfaces_.is_pending(pose.envelope.epoch)) {
        held_ = std::move(pose);
      }
    }
    return poses;
  }

  const Asset* asset() const override { return surfaces_.asset(); }
  const ChangeOver* change() const override { return surfaces_.change(); }
  std::uint32_t epoch() const override { return surfaces_.epoch(); }
  const std::optional<control::StreamInfo>& info() const override { return info_; }

  Stats stats() const override {
    const Receiver::Condition c = receiver_.condition();
    const AssetFetcher::Stats fetched = surfaces_.fetched();
    Stats s;
    static_cast<FrameDecoder::Counts&>(s) = c.counts;
    s.frames = c.frames;
    s.bytes = c.bytes;
    s.recalled = c.recalled;
    s.memory_bytes = memories_.fetched_bytes();
    s.dropped = c.dropped;
    s.reconnects = c.reconnects;
    s.surface_refused = !surfaces_.damage().empty();
    if (c.retry_at_us) s.retry_in = std::max<TimeUs>(0, *c.retry_at_us - steady_now_us());
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
    std::unique_lock lock(wake_mutex_);
    has_news_ = true;
    lock.unlock();
    woken_.notify_all();
  }

  /// Those that came just before the change.
  void carry_over(ReceivedPose& pose) const {
    const ChangeOver* change = surfaces_.change();
    if (change == nullptr || pose.envelope.epoch != change->from_epoch || !info_) return;
    // Absent bands read as those of the rest pose, of which the transfer knows nothing.
    if (pose.envelope.bands != BandMask::lowest(static_cast<std::uint8_t>(pose.band_ends.size())) || pose.next) return;
    auto C = change->transfer.apply({pose.coefficients.begin(), pose.coefficients.end()}, pose.channels);
    if (C.empty()) return;
    pose.coefficients = std::move(C);
    pose.envelope.epoch = surfaces_.epoch();
    pose.band_ends = info_->format.band_ends;
    pose.envelope.bands = BandMask::lowest(static_cast<std::uint8_t>(pose.band_ends.size()));
  }

  /// Rows that did not come become those of the rest pose; channels beyond x, y, z zero.
  void deliver(ReceivedPose pose, std::vector<ReceivedPose>& poses) const {
    // A pose brings its own layout: what was announced with it may not be what is announced now.
    const Asset& asset = *surfaces_.asset();
    if (pose.channels < 3 || pose.coefficients.size() != std::size_t{asset.rank} * pose.channels) return;
    const auto fill = [&](BandMask bands, Coefficients& coefficients) {
      for (std::size_t band = 0; band < pose.band_ends.size(); ++band) {
        if (bands.has(band)) continue;
        std::vector<double>& C = coefficients.edit();
        const auto [first, end] = band_range(pose.band_ends, band);
        for (std::size_t row = first; row < end; ++row) std::copy_n(&asset.rest[3 * row], 3, &C[row * pose.channels]);
      }
    };
    fill(pose.envelope.bands, pose.coefficients);
    if (pose.next) fill(pose.next->bands, pose.next->coefficients);
    poses.push_back(std::move(pose));
  }

  std::string live_text() const {
    if (!info_->next) return "live";
    if (!info_->next->asset.empty()) return "live, downloading a finer basis";
    return formatted("live, coarse: a finer basis is being made, %.0f %%", 100 * info_->next->progress);
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
    return {State::kLive, c.notice.empty() ? live_text() : c.notice};
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
  MemoryFetcher memories_;
  Receiver receiver_;
};

}  // namespace

Result<std::unique_ptr<Subscriber>> Subscriber::create(SubscriberOptions options, LogSink log) {
  const auto url = stream_url(options.url, options.credentials, log);
  if (!url) return url.error();
  const auto profile = options.profile ? Result<Profile>(*options.profile) : profile_from_query(url->query);
  if (!profile) return profile.error();
  const control::Subscribe subscribe{url->stream, *profile, options.sync};
  if (const auto checked = control_from_text(text_from_control(subscribe)); !checked)
    return fail(ErrorCode::kInvalidArgument, checked.error().message);
  BrokerConnection::Request request{subscribe, options.trace_every, options.declined_retry, log};
  MemoryBudget& memory = options.memory != nullptr ? *options.memory : received_memory();
  return std::unique_ptr<Subscriber>(
      std::make_unique<BrokerSubscriber>(*url, std::move(options.cache_dir), request, memory));
}

}  // namespace eigencast
