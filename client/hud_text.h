// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "client/level_control.h"
#include "common/motion/timeline.h"
#include "sdk/subscriber.h"
#include "view/surface_view.h"

namespace eigencast {

struct HudFigures {
  double keys_hz = 0, poses_hz = 0, drawn_hz = 0, kbit_per_s = 0;
  double link_kbit_per_s = 0, tls_kbit_per_s = 0;  ///< With link_bytes(), without and with TLS.
  double recalled = 0;                             ///< The part of the keys that a memory of poses predicts, and
  std::uint64_t memory_bytes = 0;                  ///< what was fetched of it.
  bool received = false;                           ///< From a broker, so that bit rate and mode mean something.
  TimeUs latency_p50_us = 0, latency_p99_us = 0;
  std::uint64_t latency_count = 0;
  std::uint64_t vertices = 0, vertices_total = 0, faces = 0;  ///< Sums over all surfaces.
  std::uint64_t vertices_wanted = 0;                          ///< As --lod and + - say.
  std::vector<double> levels;                                 ///< Drawn part of each surface's vertices.
  std::uint32_t bands = 0, bands_total = 0, rank = 0;
  std::string rebuilt;   ///< From text_from_rebuilt.
  std::string resolver;  ///< From text_from_levels; empty without a resolver.
  std::string lowered;   ///< From text_from_lowered; empty if nothing is.
  std::string shown;     ///< From text_from_shown.
  std::string mode;      ///< From text_from_mode.
  std::optional<Truth::Difference> difference;
};

inline constexpr EnumNames<Subscriber::State, 7> kStateNames{
    {"connecting", "waiting", "downloading", "live", "stalled", "lost", "refused"}};
inline constexpr EnumNames<Shown, 4> kShownNames{{"live", "interpolated", "estimated", "held"}};
/// As --playout names them.
inline constexpr EnumNames<PlayoutMode, 3> kPlayoutNames{{"latest", "interpolate", "estimate"}};

/// "refused: 401 ...": the state, and what the source says of it.
std::string text_from_state(const Subscriber::Stats& stats);

/// "raw", "interpolated x3 full", "estimated x3 damped full".
std::string text_from_mode(const Profile& profile);

/// "interpolated · 67 ms held back (smooth 100 %)".
std::string text_from_shown(Shown shown, bool settling, const Playout& playout);

/// "14:03:27.512": of the day, on the sender's clock.
std::string timecode_of(TimeUs utc_us);

/// "12.3 s behind live", "3:07 behind live", "1:02:07 behind live": as the page says it.
std::string text_from_behind(TimeUs behind_us);
/// Of a past that does not reach back so far. Empty: it does. REQUIRES: kept.spans.
std::string text_from_short_past(const Rewind::Kept& kept, TimeUs edge_us, double ago_s);
/// What a file does: "playing", "paused", "at its end", "one pose".
std::string text_from_timeline(const Timeline& timeline, TimeUs now_us);

std::string text_from_rebuilt(std::size_t on_gpu, std::size_t surfaces);

/// "budget · 60/s · 12.1 of 16.7 ms · 87 % planned".
std::string text_from_levels(const LevelControl& levels, double work_s);

/// "lowered to hold 60/s: pixels 71 %, 1 sample, small shadow, vertices 62 %": what was given up and why.
std::string text_from_lowered(const LevelControl& levels, const HudFigures& figures);

/// The most important first; Latin-1 characters only.
std::vector<std::string> hud_lines(const HudFigures& figures);

/// Describes the surface. bytes_per_s: 0 if unknown.
struct Download {
  std::uint64_t bytes = 0, total = 0;
  std::optional<double> seconds_left;  ///< Nothing if unknown or complete.
};
Download download_of(const Subscriber::Stats& stats, double bytes_per_s);

/// "downloading model 4.1 of 11.3 MB, 2 s left". has_banner: the banner says what is wrong.
std::string connection_line(const Subscriber::Stats& stats, const std::optional<control::StreamInfo>& info,
                            double bytes_per_s = 0, bool has_banner = false);

/// Why a surface is still; empty while all is well. since_us: the age of the last pose; nothing if none ever came.
std::string banner_text(const Subscriber::Stats& stats, std::optional<TimeUs> since_us);

}  // namespace eigencast
