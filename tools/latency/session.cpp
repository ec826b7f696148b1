// SPDX-License-Identifier: MIT
#include "tools/latency/session.h"

#include <time.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <future>
#include <mutex>
#include <set>
#include <thread>

#include "common/codec/key.h"
#include "common/core/timers.h"
#include "common/reconstruction/reconstruct.h"
#include "common/surface/shapes.h"
#include "sdk/asset_cache.h"
#include "sdk/bake.h"
#include "sdk/publisher.h"
#include "sdk/subscriber.h"
#include "tools/latency/presenter.h"

namespace eigencast::latency {
namespace {

using std::chrono::milliseconds;

constexpr TimeUs kConnectPatienceUs = 20'000'000;
constexpr TimeUs kDrainUs = 400'000;  ///< Poses under way, and traces, which come after their frames.
constexpr std::size_t kMostPosesKept = 240;

double process_seconds() {
  timespec t{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + static_cast<double>(t.tv_nsec) * 1e-9;
}

void sleep_until(TimeUs time_us) {
  const timespec until{time_us / 1'000'000, (time_us % 1'000'000) * 1000};
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) {
  }
}

/// Whether the broker of that URL shares our steady clock.
bool on_this_machine(const std::string& url) {
  const auto parsed = parse_broker_url(url);
  return parsed && (parsed->host == "localhost" || parsed->host == "::1" || parsed->host.rfind("127.", 0) == 0);
}

/// The sender: poses of a clip on an open-loop schedule, each stamped with the time it was meant for.
class Sending {
 public:
  static Result<std::unique_ptr<Sending>> create(const Inputs& inputs, const LogSink& log) {
    auto clip = builtin_clip(inputs.source, std::clamp(inputs.rate_hz, 1.0, 1000.0));
    if (!clip) return clip.error();
    BakeOptions bake_options;
    bake_options.rank = inputs.rank;
    auto baked = bake((*clip)->rest(), bake_options, default_cache_dir());
    if (!baked) return baked.error();
    std::unique_ptr<Sending> made(new Sending(inputs));
    for (std::size_t i = 0; i < std::min((*clip)->frame_count(), kMostPosesKept); ++i) {
      const auto pose = (*clip)->pose(i);
      if (!pose) return pose.error();
      auto& flat = made->poses_.emplace_back();
      for (const Vec3& v : *pose)
        for (const double x : v) flat.push_back(static_cast<float>(x));
    }
    const auto codec = codec_from_name(inputs.codec);
    if (!codec) return codec.error();
    PublisherOptions options;
    options.url = inputs.url;
    options.codec = *codec;
    options.key_rate_hz = inputs.rate_hz;
    auto asset = std::make_shared<const Asset>(std::move(baked->asset));
    auto encoded = std::make_shared<const EncodedAsset>(std::move(baked->encoded));
    auto publisher = Publisher::create(options, std::move(asset), std::move(encoded), log);
    if (!publisher) return publisher.error();
    made->publisher_ = std::move(*publisher);
    return made;
  }

  ~Sending() { stop(); }

  Result<void> wait_until_live(const std::atomic<bool>& stop) const {
    const TimeUs until_us = steady_now_us() + kConnectPatienceUs;
    while (publisher_->stats().state != Publisher::State::kLive) {
      if (stop) return fail(ErrorCode::kCancelled, "interrupted");
      if (steady_now_us() > until_us)
        return fail(ErrorCode::kTimeout, "the sender is not live: " + publisher_->stats().detail);
      std::this_thread::sleep_for(milliseconds(5));
    }
    return {};
  }

  void start() {
    thread_ = std::thread([this] { run(); });
  }
  void stop() {
    stopping_ = true;
    if (thread_.joinable()) thread_.join();
  }
  /// Poses meant for between these times are counted.
  void begin(TimeUs from_us) { from_us_ = from_us; }
  void end(TimeUs until_us) { until_us_ = until_us; }
  std::uint64_t sent() const { return sent_; }
  std::uint64_t missed() const { return missed_; }
  std::uint64_t dropped() const { return dropped_; }
  const HdrHistogram& lag_us() const { return lag_us_; }  ///< After stop().

 private:
  explicit Sending(const Inputs& inputs) : interval_us_(1e6 / inputs.rate_hz) {}

  void run() {
    sleep_on_time();
    const TimeUs start_us = steady_now_us() + 1000;
    for (std::uint64_t i = 0; !stopping_; ++i) {
      const TimeUs intended_us = start_us + static_cast<TimeUs>(interval_us_ * static_cast<double>(i));
      const TimeUs next_us = start_us + static_cast<TimeUs>(interval_us_ * static_cast<double>(i + 1));
      if (steady_now_us() >= next_us) {  // Its time is over: counted, not made up for.
        missed_ += counts(intended_us) ? 1 : 0;
        continue;
      }
      sleep_until(intended_us);
      const TimeUs lag_us = steady_now_us() - intended_us;
      const auto status = publisher_->send_positions(poses_[i % poses_.size()], intended_us);
      if (!counts(intended_us)) continue;
      lag_us_.add(lag_us);
      if (status && *status == SendStatus::kSent) {
        ++sent_;
      } else {
        ++dropped_;
      }
    }
  }

  bool counts(TimeUs intended_us) const {
    return from_us_ != 0 && intended_us >= from_us_ && (until_us_ == 0 || intended_us < until_us_);
  }

  const double interval_us_;
  std::vector<std::vector<float>> poses_;
  std::unique_ptr<Publisher> publisher_;
  std::atomic<bool> stopping_{false};
  std::atomic<TimeUs> from_us_{0}, until_us_{0};
  std::atomic<std::uint64_t> sent_{0}, missed_{0}, dropped_{0};
  HdrHistogram lag_us_;
  std::thread thread_;
};

/// The viewer whose poses are measured through to the rebuilt surface.
class Watching {
 public:
  static Result<std::unique_ptr<Watching>> create(const Inputs& inputs, bool one_clock, const LogSink& log) {
    SubscriberOptions options;
    options.url = inputs.viewer_url.empty() ? inputs.url : inputs.viewer_url;
    Profile profile;
    profile.rate = inputs.interpolation > 1 ? Profile::Rate::kInterpolated : Profile::Rate::kRaw;
    if (inputs.interpolation > 1) profile.k = static_cast<std::uint8_t>(inputs.interpolation);
    profile.form = inputs.form == "compact" ? Profile::Form::kCompact : Profile::Form::kFull;
    options.profile = profile;
    options.trace_every = inputs.trace_every;
    const TimeUs start_us = steady_now_us();
    auto subscriber = Subscriber::create(options, log);
    if (!subscriber) return subscriber.error();
    std::unique_ptr<Watching> made(new Watching(inputs, one_clock, start_us));
    made->subscriber_ = std::move(*subscriber);
    std::promise<Result<void>> ready;
    auto is_ready = ready.get_future();
    made->thread_ = std::thread([w = made.get(), told = std::move(ready)]() mutable {
      const Result<void> prepared = w->prepare();  // On the thread that OpenGL will be used on.
      const bool good = bool{prepared};
      told.set_value(prepared);
      if (good) w->run();
    });
    if (const Result<void> prepared = is_ready.get(); !prepared) return prepared.error();
    return made;
  }

  ~Watching() { stop(); }
  void stop() {
    stopping_ = true;
    if (thread_.joinable()) thread_.join();
  }
  /// What is counted begins, or ends, with poses of that capture time and after.
  void begin(TimeUs from_us) { from_us_ = from_us; }
  void end(TimeUs until_us) { until_us_ = until_us; }
  bool has_surface() const { return first_surface_us_ != 0; }
  bool has_whole_surface() const { return whole_asset_us_ != 0; }
  std::string detail() const {
    const std::lock_guard lock(mutex_);
    return detail_;
  }
  Progress progress() const {
    const std::lock_guard lock(mutex_);
    const HdrHistogram& h = outcome_.keys;
    return {
        0, 0, outcome_.counts.keys_received, outcome_.counts.synthetic_received, h.percentile(50), h.percentile(99)};
  }
  /// After stop(): fills in what the viewer knows.
  void tell(Outcome& outcome);

 private:
  Watching(const Inputs& inputs, bool one_clock, TimeUs start_us)
      : inputs_(inputs),
        one_clock_(one_clock),
        start_us_(start_us),
        timeline_({one_clock, one_clock && on_this_machine(inputs.url)}) {}
  Result<void> prepare();
  void run();
  void take(const ReceivedPose& pose, TimeUs taken_us);
  void count(const ReceivedPose& pose, TimeUs shown_us);
  bool counts(const ReceivedPose& pose) const;
  void take_traces();

  const Inputs inputs_;
  const bool one_clock_;
  const TimeUs start_us_;
  std::unique_ptr<Subscriber> subscriber_;
  std::unique_ptr<Presenter> presenter_;  ///< Lives and dies on the thread.
  Reconstructor reconstructor_;
  std::uint32_t reconstructed_epoch_ = 0;
  std::vector<float> positions_;
  DisplayAge age_;
  Timeline timeline_;
  std::set<std::pair<std::uint64_t, std::uint8_t>> seen_;  ///< Of the newest keys.
  TimeUs newest_capture_us_ = 0;
  std::uint64_t bytes_at_begin_ = 0, skipped_at_begin_ = 0;
  TimeUs counted_from_us_ = 0;
  std::atomic<bool> stopping_{false};
  std::atomic<TimeUs> from_us_{0}, until_us_{0}, first_surface_us_{0}, whole_asset_us_{0};
  TimeUs first_picture_us_ = 0;
  mutable std::mutex mutex_;
  std::string detail_;  ///< GUARDED_BY(mutex_)
  Outcome outcome_;     ///< GUARDED_BY(mutex_) for what progress() reads.
  std::thread thread_;
};

Result<void> Watching::prepare() {
  if (inputs_.present.empty()) return {};
  auto made = make_presenter(inputs_.present);
  if (!made) return made.error();
  presenter_ = std::move(*made);
  outcome_.device = presenter_->device();
  return {};
}

void Watching::run() {
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
    detail_ = stats.detail;
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
    bytes_at_begin_ = stats.bytes;
    skipped_at_begin_ = stats.skipped;
  }
  outcome_.vertices_rebuilt = level;
  outcome_.seconds = static_cast<double>(shown_us - counted_from_us_) / 1e6;
  outcome_.kbit_per_s =
      outcome_.seconds > 0 ? static_cast<double>(stats.bytes - bytes_at_begin_) * 8e-3 / outcome_.seconds : 0;
  outcome_.counts.superseded = stats.skipped - skipped_at_begin_;
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
  const TimeUs second_us = (shown_us - counted_from_us_) / 1'000'000 * 1'000'000;
  if (outcome_.intervals.empty() || outcome_.intervals.back().start_us < second_us)
    outcome_.intervals.push_back({second_us, 1'000'000, {}, {}});
  (key ? outcome_.intervals.back().keys : outcome_.intervals.back().synthetic).add(latency_us);
}

void Watching::take_traces() {
  for (const control::Trace& trace : subscriber_->take_traces()) {
    if (from_us_ == 0) continue;
    if (trace.broker_clock)
      outcome_.sender_clock.add(
          {steady_now_us() - start_us_, trace.broker_clock->offset_us, trace.broker_clock->error_us});
    timeline_.add(trace);
  }
  for (StagedPose& pose : timeline_.take()) {
    ++outcome_.counts.traced;
    if (outcome_.samples.size() < kMostSamples) outcome_.samples.push_back(pose);
  }
}

void Watching::tell(Outcome& outcome) {
  take_traces();
  std::swap(outcome, outcome_);
  const Subscriber::Stats stats = subscriber_->stats();
  outcome.counts.trace_incomplete = timeline_.incomplete();
  if (first_surface_us_ != 0) outcome.first_surface_us = first_surface_us_;
  if (whole_asset_us_ != 0) outcome.whole_asset_us = whole_asset_us_;
  if (first_picture_us_ != 0 && !outcome.device.empty()) outcome.first_picture_us = first_picture_us_;
  outcome.age_us = age_.ages_us();
  outcome.asset_bytes = stats.asset_bytes_total;
  if (const Asset* asset = subscriber_->asset()) outcome.vertices = asset->vertex_count;
}

/// Stage statistics, and whether the stages add up to the total.
void sum_up(Outcome& outcome) {
  for (const StagedPose& pose : outcome.samples) {
    const TimeUs held_us = pose.stages[static_cast<std::size_t>(Stage::kHold)].us +
                           pose.stages[static_cast<std::size_t>(Stage::kMargin)].us;
    if (held_us > 0) outcome.held_us.add(held_us);
    const bool key = pose.is_key() || pose.envelope.step.at == pose.envelope.step.of;
    auto& stages = key ? outcome.key_stages : outcome.synthetic_stages;
    for (std::size_t i = 0; i < kStages; ++i) {
      stages[i].add(pose.stages[i].us);
      outcome.stage_error_us[i] = std::max(outcome.stage_error_us[i], pose.stages[i].error_us);
    }
    outcome.total_error_us = std::max(outcome.total_error_us, pose.total.error_us);
    (key ? outcome.key_totals : outcome.synthetic_totals).add(pose.total.us);
    if (!outcome.one_clock) {
      (key ? outcome.keys : outcome.synthetic).add(pose.total.us);
      if (static_cast<double>(pose.total.us) > outcome.inputs.late_ms * 1000) ++outcome.counts.late;
    }
    if (key) outcome.keys_uncorrected.add(pose.total.us - pose.stages[static_cast<std::size_t>(Stage::kSchedule)].us);
    const TimeUs unexplained_us = std::abs(pose.unexplained_us());
    ++outcome.sums_checked;
    if (!pose.is_possible()) ++outcome.impossible;
    if (unexplained_us > pose.uncertainty_us()) ++outcome.sums_wrong;
    outcome.worst_unexplained_us = std::max(outcome.worst_unexplained_us, unexplained_us);
  }
}

}  // namespace

Result<Outcome> run_session(const Inputs& inputs, const std::atomic<bool>& stop, const OnProgress& progress,
                            LogSink log) {
  const bool sends = inputs.mode == "loop" || inputs.mode == "publish";
  const bool watches = inputs.mode != "publish";
  std::unique_ptr<Sending> sending;
  std::unique_ptr<Load> load;
  std::unique_ptr<Watching> watching;
  if (sends) {
    auto made = Sending::create(inputs, log);
    if (!made) return made.error();
    sending = std::move(*made);
    if (auto live = sending->wait_until_live(stop); !live) return live.error();
    sending->start();
  }
  if (watches && inputs.clients > 1) {
    const std::string profile = inputs.interpolation > 1
                                    ? "?rate=" + std::to_string(inputs.interpolation) + "&form=" + inputs.form
                                    : "?rate=raw";
    const std::string url = inputs.viewer_url.empty() ? inputs.url : inputs.viewer_url;
    auto made = Load::start({url + profile, inputs.clients - 1, 100'000}, kConnectPatienceUs);
    if (!made) return made.error();
    load = std::move(*made);
  }
  const TimeUs patience_us = steady_now_us() + kConnectPatienceUs;
  if (watches) {
    auto made = Watching::create(inputs, inputs.mode == "loop", log);
    if (!made) return made.error();
    watching = std::move(*made);
    while (!watching->has_surface() && !stop) {
      if (steady_now_us() > patience_us)
        return fail(ErrorCode::kTimeout, "no pose came within 20 s: " + watching->detail());
      std::this_thread::sleep_for(milliseconds(5));
    }
    // A slow link may still be bringing the surface: what is measured is the whole of it, where that comes in time.
    while (!watching->has_whole_surface() && !stop && steady_now_us() < patience_us)
      std::this_thread::sleep_for(milliseconds(5));
  }
  const auto sleep = [&](TimeUs until_us, TimeUs begin_us) {
    while (!stop && steady_now_us() < until_us) {
      std::this_thread::sleep_for(std::chrono::microseconds(std::min<TimeUs>(200'000, until_us - steady_now_us() + 1)));
      if (!progress || begin_us == 0) continue;
      Progress p = watching ? watching->progress() : Progress{};
      if (!watching) p.keys = sending->sent();
      p.seconds = static_cast<double>(steady_now_us() - begin_us) / 1e6;
      p.of = inputs.duration_s;
      progress(p);
    }
  };
  sleep(steady_now_us() + static_cast<TimeUs>(inputs.warmup_s * 1e6), 0);
  const TimeUs begin_us = steady_now_us();
  timespec wall{};
  clock_gettime(CLOCK_REALTIME, &wall);
  const double cpu_start = process_seconds();
  if (sending) sending->begin(begin_us);
  if (load) load->begin();
  // Of a sender elsewhere the clock is not known: all that comes from now on counts.
  if (watching) watching->begin(inputs.mode == "loop" ? begin_us : 1);
  sleep(begin_us + static_cast<TimeUs>(inputs.duration_s * 1e6), begin_us);
  const TimeUs end_us = steady_now_us();
  const double cpu = (process_seconds() - cpu_start) / (static_cast<double>(end_us - begin_us) / 1e6);
  if (sending) sending->end(end_us);
  if (watching && inputs.mode == "loop") watching->end(end_us);
  std::optional<Load::Figures> load_figures;
  if (load) load_figures = load->finish();
  if (sending) {
    // Traces leave with the frames after theirs: the sender goes on for a little, uncounted by the viewer.
    std::this_thread::sleep_for(std::chrono::microseconds(kDrainUs));
    sending->stop();
  }
  if (watching) watching->stop();

  Outcome outcome;
  if (watching) watching->tell(outcome);
  outcome.inputs = inputs;
  outcome.one_clock = inputs.mode == "loop";
  outcome.one_machine = outcome.one_clock && on_this_machine(inputs.url);
  outcome.load = std::move(load_figures);
  outcome.cpu_share = cpu;
  outcome.start_unix_s = static_cast<double>(wall.tv_sec) + static_cast<double>(wall.tv_nsec) * 1e-9;
  if (outcome.seconds == 0) outcome.seconds = static_cast<double>(end_us - begin_us) / 1e6;
  if (sending) {
    outcome.counts.keys_sent = sending->sent();
    if (watching) {
      const std::uint64_t received = std::min(outcome.counts.keys_received, outcome.counts.keys_sent);
      const std::uint64_t missing = outcome.counts.keys_sent - received;
      outcome.counts.keys_lost = missing - std::min(missing, outcome.counts.superseded + outcome.counts.overtaken);
    }
    outcome.counts.sends_missed = sending->missed();
    outcome.counts.sends_dropped = sending->dropped();
    outcome.send_lag_us = sending->lag_us();
  }
  sum_up(outcome);
  return outcome;
}

}  // namespace eigencast::latency
