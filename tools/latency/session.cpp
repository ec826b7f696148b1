// SPDX-License-Identifier: MIT
#include "tools/latency/session.h"

#include <time.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <memory>
#include <thread>

#include "common/core/clock.h"
#include "common/surface/shapes/shapes.h"
#include "sdk/asset_cache.h"
#include "sdk/bake.h"
#include "sdk/publisher.h"
#include "tools/latency/watching.h"

namespace eigencast::latency {
namespace {

using std::chrono::milliseconds;

constexpr TimeUs kDrainUs = 400'000;  ///< Poses under way, and traces, which come after their frames.

constexpr std::size_t kMaxPoses = 240;

/// A thread that sleeps wakes late; so long before a pose is due it is awake and watches the clock.
constexpr TimeUs kAwakeBeforeUs = 150;

void wait_until(TimeUs time_us) {
  const TimeUs awake_us = time_us - kAwakeBeforeUs;
  const timespec until{awake_us / 1'000'000, (awake_us % 1'000'000) * 1000};
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) {
  }
  while (steady_now_us() < time_us) {
  }
}

/// How long a sender may take until it is live, and a viewer until it has a pose.
constexpr TimeUs kConnectPatienceUs = 20'000'000;

/// Poses on an open-loop schedule, each stamped with the time it was meant for, from a thread of its own.
class Sending {
 public:
  /// Begins to connect. Errors: those of clips, bakes and publishers.
  static Result<std::unique_ptr<Sending>> create(const Inputs& inputs, const LogSink& log) {
    auto clip = builtin_clip(inputs.source, std::clamp(inputs.rate_hz, 1.0, 1000.0));
    if (!clip) return clip.error();
    BakeOptions bake_options;
    bake_options.rank = inputs.rank;
    auto baked = bake((*clip)->rest(), bake_options, default_cache_dir());
    if (!baked) return baked.error();
    std::unique_ptr<Sending> made(new Sending(inputs));
    for (std::size_t i = 0; i < std::min((*clip)->frame_count(), kMaxPoses); ++i) {
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
    options.credentials = inputs.credentials;
    auto asset = std::make_shared<const Asset>(std::move(baked->asset));
    auto encoded = std::make_shared<const EncodedAsset>(std::move(baked->encoded));
    const auto good = store(made->publisher_, Publisher::create(options, std::move(asset), std::move(encoded), log));
    if (!good) return good.error();
    return made;
  }
  ~Sending() { stop(); }

  /// Errors: kTimeout, kRefused (by the broker), kCancelled (stop was set).
  Result<void> wait_until_live(const std::atomic<bool>& stop) const {
    const TimeUs until_us = steady_now_us() + kConnectPatienceUs;
    while (publisher_->stats().state != Publisher::State::kLive) {
      if (stop) return fail(ErrorCode::kCancelled, "interrupted");
      if (publisher_->stats().state == Publisher::State::kRefused)
        return fail(ErrorCode::kRefused, publisher_->stats().detail);
      if (steady_now_us() > until_us)
        return fail(ErrorCode::kTimeout, "the sender is not live: " + publisher_->stats().detail);
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
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

  /// Counts the poses that are meant for times from begin() to end().
  void begin(TimeUs from_us) { from_us_ = from_us; }
  void end(TimeUs until_us) { until_us_ = until_us; }
  std::uint64_t sent() const { return sent_; }
  std::uint64_t missed() const { return missed_; }
  std::uint64_t dropped() const { return dropped_; }
  const HdrHistogram& lag_us() const { return lag_us_; }  ///< After stop().

 private:
  explicit Sending(const Inputs& inputs) : interval_us_(1e6 / inputs.rate_hz) {}
  void run() {
    sleep_on_time();  // As a sender does.
    run_when_woken(kMakingPoses);
    const TimeUs start_us = steady_now_us() + 1000;
    for (std::uint64_t i = 0; !stopping_; ++i) {
      const TimeUs intended_us = start_us + static_cast<TimeUs>(interval_us_ * static_cast<double>(i));
      const TimeUs next_us = start_us + static_cast<TimeUs>(interval_us_ * static_cast<double>(i + 1));
      if (steady_now_us() >= next_us) {  // Its time is over: counted, not made up for.
        missed_ += counts(intended_us) ? 1 : 0;
        continue;
      }
      wait_until(intended_us);
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

void sum_up(Outcome& outcome) {
  for (const StagedPose& pose : outcome.samples) {
    const TimeUs held_us = pose.at(Stage::kHold).us + pose.at(Stage::kMargin).us;
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
    if (key) outcome.keys_uncorrected.add(pose.total.us - pose.at(Stage::kSchedule).us);
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
  const bool sends = inputs.sends(), watches = inputs.watches();
  std::unique_ptr<Sending> sending;
  std::unique_ptr<Load> load;
  std::unique_ptr<Watching> watching;
  if (sends) {
    if (const auto good = store(sending, Sending::create(inputs, log)); !good) return good.error();
    if (auto live = sending->wait_until_live(stop); !live) return live.error();
    sending->start();
  }
  if (watches && inputs.clients > 1) {
    const Load::Options light{inputs.url_of_viewers(), inputs.clients - 1, inputs.profile(), inputs.credentials};
    if (const auto good = store(load, Load::start(light, kConnectPatienceUs)); !good) return good.error();
  }
  const TimeUs patience_us = steady_now_us() + kConnectPatienceUs;
  if (watches) {
    if (const auto good = store(watching, Watching::create(inputs, inputs.mode == "loop", log)); !good)
      return good.error();
    while (!watching->has_surface() && !stop) {
      const auto [state, detail] = watching->connection();
      if (state == Subscriber::State::kRefused) return fail(ErrorCode::kRefused, detail);
      if (steady_now_us() > patience_us) return fail(ErrorCode::kTimeout, "no pose came within 20 s: " + detail);
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
      if (sending) p.sent = sending->sent();
      if (!watching) p.keys = p.sent;
      p.seconds = static_cast<double>(steady_now_us() - begin_us) / 1e6;
      p.of = inputs.duration_s;
      progress(p);
    }
  };
  sleep(steady_now_us() + static_cast<TimeUs>(inputs.warmup_s * 1e6), 0);
  const TimeUs begin_us = steady_now_us();
  const double start_unix_s = seconds_of(CLOCK_REALTIME);
  const double cpu_start = seconds_of(CLOCK_PROCESS_CPUTIME_ID);
  if (sending) sending->begin(begin_us);
  if (load) load->begin();
  // The clock of a sender elsewhere is not known: all that comes from now on counts.
  if (watching) watching->begin(inputs.mode == "loop" ? begin_us : 1);
  sleep(begin_us + static_cast<TimeUs>(inputs.duration_s * 1e6), begin_us);
  const TimeUs end_us = steady_now_us();
  const double cpu =
      (seconds_of(CLOCK_PROCESS_CPUTIME_ID) - cpu_start) / (static_cast<double>(end_us - begin_us) / 1e6);
  if (sending) sending->end(end_us);
  if (watching && inputs.mode == "loop") watching->end(end_us);
  const auto connection = watching ? watching->connection() : Watching::Connection{Subscriber::State::kLive, {}};
  std::optional<Load::Figures> load_figures;
  if (load) load_figures = load->finish();
  if (sending) {
    // Traces leave with the frames after theirs: the sender goes on for a little, uncounted by the viewer.
    std::this_thread::sleep_for(std::chrono::microseconds(kDrainUs));
    sending->stop();
  }
  if (watching) watching->stop();

  Outcome outcome;
  if (watching) watching->report_to(outcome);
  outcome.inputs = inputs;
  if (connection.state != Subscriber::State::kLive) outcome.trouble = connection.detail;
  if (sends) {
    outcome.rank = inputs.rank;
    outcome.key_rate_hz = inputs.rate_hz;
  }
  outcome.one_clock = inputs.mode == "loop";
  outcome.one_machine = outcome.one_clock && on_this_machine(inputs.url);
  outcome.load = std::move(load_figures);
  outcome.cpu_share = cpu;
  outcome.start_unix_s = start_unix_s;
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
