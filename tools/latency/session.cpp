// SPDX-License-Identifier: MIT
#include "tools/latency/session.h"

#include <time.h>

#include <algorithm>
#include <cstdlib>
#include <thread>

#include "tools/latency/load.h"
#include "tools/latency/sending.h"
#include "tools/latency/watching.h"

namespace eigencast::latency {
namespace {

using std::chrono::milliseconds;

constexpr TimeUs kDrainUs = 400'000;  ///< Poses under way, and traces, which come after their frames.

double process_seconds() {
  timespec t{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + static_cast<double>(t.tv_nsec) * 1e-9;
}

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
  const bool sends = inputs.sends(), watches = inputs.watches();
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
    auto made = Load::start({inputs.url_of_viewers(), inputs.clients - 1, inputs.profile(), inputs.credentials},
                            kConnectPatienceUs);
    if (!made) return made.error();
    load = std::move(*made);
  }
  const TimeUs patience_us = steady_now_us() + kConnectPatienceUs;
  if (watches) {
    auto made = Watching::create(inputs, inputs.mode == "loop", log);
    if (!made) return made.error();
    watching = std::move(*made);
    while (!watching->has_surface() && !stop) {
      if (watching->refused()) return fail(ErrorCode::kRefused, watching->detail());
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
  const std::string trouble = watching ? watching->trouble() : std::string();
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
  outcome.trouble = trouble;
  if (sends) {
    outcome.rank = inputs.rank;
    outcome.key_rate_hz = inputs.rate_hz;
  }
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
