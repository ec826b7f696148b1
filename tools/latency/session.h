// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <atomic>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "common/core/log.h"
#include "common/net/url.h"
#include "common/wire/link_bytes.h"
#include "tools/latency/hdr_histogram.h"
#include "tools/latency/load.h"
#include "tools/latency/over_time.h"
#include "tools/latency/timeline.h"

namespace eigencast::latency {

/// Echoed in the report, but for what is secret.
struct Inputs {
  std::string mode = "loop";     ///< loop, publish, subscribe, passive
  std::string url;               ///< Names broker and stream.
  std::string viewer_url;        ///< Where viewers go, if not there (through a relay).
  Credentials credentials;       ///< For all of these; in no report.
  std::string source = "heart";  ///< Built-in shape.
  int rank = 200;
  std::string codec = "quantised";
  double rate_hz = 30;
  int interpolation = 1;      ///< Poses per key; 1: raw.
  double lod = 1;             ///< Share of the vertices that are rebuilt.
  std::string present;        ///< Pixels of the pictures, "1440x900"; empty: none are made.
  std::uint32_t clients = 1;  ///< One full viewer, the others light.
  double duration_s = 10, warmup_s = 2;
  std::uint32_t trace_every = 1;  ///< Keys that are traced.
  double late_ms = 100;           ///< A pose older than that counts as late.

  const std::string& url_of_viewers() const { return viewer_url.empty() ? url : viewer_url; }
  Profile profile() const {
    Profile asked;
    asked.rate = interpolation > 1 ? Profile::Rate::kInterpolated : Profile::Rate::kRaw;
    if (interpolation > 1) asked.k = static_cast<std::uint8_t>(interpolation);
    return asked;
  }
  bool sends() const { return mode == "loop" || mode == "publish"; }
  bool watches() const { return mode != "publish"; }
};

struct Counts {
  std::uint64_t keys_sent = 0;      ///< While measured.
  std::uint64_t sends_missed = 0;   ///< Scheduled, but the sender was too late for them.
  std::uint64_t sends_dropped = 0;  ///< The link was behind.
  std::uint64_t keys_received = 0;
  std::uint64_t synthetic_received = 0;
  std::uint64_t keys_lost = 0;   ///< Sent, and by the end neither received nor reported as superseded.
  std::uint64_t superseded = 0;  ///< Frames that newer ones overtook in the broker, as it says: intended.
  std::uint64_t overtaken = 0;   ///< Poses that came together with a newer one: a picture was made of that only.
  std::uint64_t late = 0;
  std::uint64_t duplicate = 0;
  std::uint64_t out_of_order = 0;
  std::uint64_t traced = 0, trace_incomplete = 0;
};

struct Outcome {
  Inputs inputs;
  bool one_clock = true;         ///< Sender and viewer are one process.
  bool one_machine = false;      ///< And the broker is on the same machine: its steady clock is ours.
  HdrHistogram keys, synthetic;  ///< Intended time to rebuilt surface or picture, all poses; of the traced ones where
                                 ///< the sender has another clock.
  HdrHistogram
      keys_uncorrected;  ///< As if the schedule had no part in it: actual beginning to rebuilt surface; traced keys.
  std::array<HdrHistogram, kStages> key_stages, synthetic_stages;
  HdrHistogram key_totals, synthetic_totals;  ///< Count the traced poses, which the stages are of.
  std::uint64_t sums_checked = 0, sums_wrong = 0, impossible = 0;
  TimeUs worst_unexplained_us = 0;
  HdrHistogram held_us;  ///< What interpolation made poses wait, margin included; empty where raw.
  std::array<TimeUs, kStages> stage_error_us{};  ///< Worst bound met in each stage.
  TimeUs total_error_us = 0;                     ///< And in a total.
  HdrHistogram age_us;  ///< That of the pose on display, sampled every millisecond; needs one clock.
  ClockTrack sender_clock, viewer_clock;
  std::optional<TimeUs> round_trip_us;
  std::optional<TimeUs> first_surface_us;  ///< From the subscription to the first rebuilt surface.
  std::optional<TimeUs> first_picture_us;  ///< And to its picture.
  std::optional<TimeUs> whole_asset_us;    ///< And until the whole surface had arrived.
  std::string device;                      ///< That draws the pictures.
  std::uint64_t asset_bytes = 0;
  std::uint32_t vertices = 0, vertices_rebuilt = 0;
  /// Those that the sender announced, where that is not this process.
  int rank = 0;
  double key_rate_hz = 0;        ///< 0: not said.
  std::string trouble;           ///< Why the stream was not live when measuring ended; empty: it was.
  std::uint64_t reconnects = 0;  ///< Counts the viewer's, while measured.
  double kbit_per_s = 0;
  LinkBytes link{};                ///< While measured, and
  std::uint64_t recalled = 0;      ///< of the keys, those that a memory predicted, and
  std::uint64_t memory_bytes = 0;  ///< what was fetched of it.
  Counts counts;
  std::optional<Load::Figures> load;
  HdrHistogram send_lag_us;  ///< How late the sender's thread woke.
  double cpu_share = 0;      ///< The whole process's, of one core.
  double seconds = 0, start_unix_s = 0;
  Intervals intervals;
  std::vector<StagedPose> samples;  ///< At most kMaxStagedPoses.
};
inline constexpr std::size_t kMaxStagedPoses = 200'000;

struct Progress {
  double seconds = 0, of = 0;
  std::uint64_t sent = 0, keys = 0, synthetic = 0, traced = 0;
  std::int64_t p50_us = 0, p99_us = 0;
};
using OnProgress = std::function<void(const Progress&)>;

/// Ends by its deadline whatever is lost, sooner when `stop` is set.
/// Errors: kInvalidArgument, kUnreachable, kRefused (by the broker), kTimeout (no pose came).
Result<Outcome> run_session(const Inputs& inputs, const std::atomic<bool>& stop, const OnProgress& progress,
                            LogSink log);

}  // namespace eigencast::latency
