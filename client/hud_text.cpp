// SPDX-License-Identifier: MIT
#include "client/hud_text.h"

#include <algorithm>
#include <cmath>

#include "common/core/text.h"

namespace eigencast {
namespace {

std::string with_commas(std::uint64_t number) {
  std::string digits = std::to_string(number);
  for (std::size_t at = digits.size(); at > 3; at -= 3) digits.insert(at - 3, ",");
  return digits;
}

std::string milliseconds(TimeUs us) {
  const double ms = static_cast<double>(us) / 1000;
  return formatted(ms < 10 ? "%.1f ms" : "%.0f ms", ms);
}

/// "LOD of each 1.00 0.42 0.07": the first eight.
std::string text_from_each(const std::vector<double>& levels) {
  constexpr std::size_t kMaxListed = 8;
  std::string line = "of each";
  for (std::size_t i = 0; i < std::min(levels.size(), kMaxListed); ++i) line += formatted(" %.2f", levels[i]);
  return levels.size() > kMaxListed ? line + " ..." : line;
}

/// "4.1 of 11.3 MB, 4 s left", "4.1 of 11.3 MB, 2 min left"
std::string text_from_download(const Download& d) {
  const std::string text =
      formatted("%.1f of %.1f MB", static_cast<double>(d.bytes) / 1e6, static_cast<double>(d.total) / 1e6);
  if (!d.seconds_left) return text;
  const bool short_time = *d.seconds_left < 90;
  return text + formatted(short_time ? ", %.0f s left" : ", %.0f min left",
                          std::ceil(short_time ? *d.seconds_left : *d.seconds_left / 60));
}

}  // namespace

std::string text_from_mode(const Profile& profile) {
  if (profile.rate == Profile::Rate::kRaw) return "raw";
  const bool estimated = profile.rate == Profile::Rate::kEstimated;
  std::string mode = formatted("%s x%d", estimated ? "estimated" : "interpolated", profile.k);
  if (profile.scheme == Profile::Scheme::kHermite) mode += " hermite";
  if (profile.scheme == Profile::Scheme::kCatmullRom) mode += " catmull-rom";
  if (profile.scheme == Profile::Scheme::kDamped) mode += " damped";
  return mode;
}

std::string text_from_shown(Shown shown, bool settling, const Playout& playout) {
  std::string line(kShownNames[shown]);
  if (settling) line += ", going over";
  if (playout.settings().mode == PlayoutMode::kLatest) return line + " \xC2\xB7 as it comes";
  line += " \xC2\xB7 " + milliseconds(playout.delay_us()) + " held back";
  const double percent = 100 * playout.smoothness();
  return line + (playout.settings().delay_us > 0 ? std::string() : formatted(" (smooth %.0f %%)", percent));
}

std::string timecode_of(TimeUs utc_us) {
  constexpr TimeUs kDayUs = TimeUs{86'400} * 1'000'000;
  const auto ms = static_cast<int>((utc_us % kDayUs + kDayUs) % kDayUs / 1000);
  return formatted("%02d:%02d:%02d.%03d", ms / 3'600'000, ms / 60'000 % 60, ms / 1000 % 60, ms % 1000);
}

std::string text_from_behind(TimeUs behind_us) {
  const TimeUs tenths = std::max<TimeUs>(0, behind_us) / 100'000;
  const auto s = static_cast<int>(tenths / 10);
  const std::string time = s >= 3600 ? formatted("%d:%02d:%02d", s / 3600, s / 60 % 60, s % 60)
                           : s >= 60 ? formatted("%d:%02d", s / 60, s % 60)
                                     : formatted("%d.%d s", s, static_cast<int>(tenths % 10));
  return time + " behind live";
}

std::string text_from_short_past(const Rewind::Kept& kept, TimeUs edge_us, double ago_s) {
  constexpr double kSlackS = 1;  // a second of what is kept goes while one asks
  const double kept_s = static_cast<double>(edge_us - kept.spans.front().from_us) / 1e6;
  if (ago_s <= kept_s + kSlackS) return {};
  return formatted("--ago %.6g: the broker keeps the last %.0f s, it begins there", ago_s, kept_s);
}

std::string text_from_rebuilt(std::size_t on_gpu, std::size_t surfaces) {
  if (surfaces == 0) return {};
  if (on_gpu == 0) return "rebuilt on the CPU";
  if (on_gpu == surfaces) return "rebuilt on the GPU";
  return formatted("rebuilt on the GPU: %zu, on the CPU: %zu", on_gpu, surfaces - on_gpu);
}

std::string text_from_levels(const LevelControl& levels, double work_s) {
  const double f0 = levels.target_fps();
  const std::string line = std::string(kResolverNames[levels.kind()]) +
                           formatted(" \xC2\xB7 %.4g/s \xC2\xB7 %.1f of %.1f ms", f0, 1000 * work_s, 1000 / f0);
  if (levels.kind() == ResolverKind::kPaper) return line + formatted(" \xC2\xB7 kappa %.2f", levels.state());
  // Over twice a picture's time: not even the fewest vertices would hold the rate.
  return line + (levels.state() > 2 ? std::string(" \xC2\xB7 out of reach here")
                                    : formatted(" \xC2\xB7 %.0f %% planned", 100 * levels.state()));
}

std::string text_from_lowered(const LevelControl& levels, const HudFigures& figures) {
  const PictureQuality& quality = levels.quality();
  std::vector<std::string> parts;
  if (quality.scale != 1) parts.push_back(formatted("pixels %.0f %%", 100 * static_cast<double>(quality.scale)));
  if (quality.samples == 1) parts.emplace_back("1 sample");
  if (quality.shadow != ShadowQuality::kFull)
    parts.emplace_back(quality.shadow == ShadowQuality::kSmall ? "small shadow" : "no shadow");
  if (!quality.ground) parts.emplace_back("no ground");
  if (levels.active() && figures.vertices < figures.vertices_wanted)
    parts.push_back(formatted(
        "vertices %.0f %%", 100 * static_cast<double>(figures.vertices) / static_cast<double>(figures.vertices_total)));
  if (parts.empty()) return {};
  std::string text = levels.settings().quality == QualityMode::kLow
                         ? std::string("low quality as asked: ")
                         : formatted("lowered to hold %.4g/s: ", levels.target_fps());
  for (const std::string& part : parts) text += (&part == &parts.front() ? "" : ", ") + part;
  return text;
}

std::vector<std::string> hud_lines(const HudFigures& f) {
  std::vector<std::string> lines;
  lines.push_back(
      formatted("%.0f keys/s \xC2\xB7 %.0f poses/s \xC2\xB7 %.0f drawn/s", f.keys_hz, f.poses_hz, f.drawn_hz));
  if (f.received)
    lines.push_back(formatted("%.0f kbit/s, on the link %.0f (TLS %.0f) \xC2\xB7 ", f.kbit_per_s, f.link_kbit_per_s,
                              f.tls_kbit_per_s) +
                    (f.latency_count == 0 ? std::string("latency not known yet")
                                          : "latency " + milliseconds(f.latency_p50_us) + " (p99 " +
                                                milliseconds(f.latency_p99_us) + ")"));
  const double level =
      f.vertices_total == 0 ? 0 : static_cast<double>(f.vertices) / static_cast<double>(f.vertices_total);
  lines.push_back(formatted("LOD %.2f \xC2\xB7 ", level) + with_commas(f.vertices) + " of " +
                  with_commas(f.vertices_total) + " vertices" +
                  (f.faces == 0 ? std::string(", points") : ", " + with_commas(f.faces) + " faces"));
  if (f.difference)
    lines.push_back(formatted("difference rms %.3g %%, largest %.3g %% of the diagonal", 100 * f.difference->rms,
                              100 * f.difference->largest));
  if (f.received) lines.push_back(f.mode);
  if (f.memory_bytes > 0)
    lines.push_back(formatted("memory %.1f kB \xC2\xB7 predicts %.0f %% of keys",
                              static_cast<double>(f.memory_bytes) * 1e-3, 100 * f.recalled));
  if (!f.shown.empty()) lines.push_back(f.shown);
  if (!f.resolver.empty()) lines.push_back(f.resolver);
  if (!f.lowered.empty()) lines.push_back(f.lowered);
  lines.push_back(formatted("bands %u of %u \xC2\xB7 rank %u", f.bands, f.bands_total, f.rank) +
                  (f.rebuilt.empty() ? "" : " \xC2\xB7 " + f.rebuilt));
  if (f.levels.size() > 1) lines.push_back(text_from_each(f.levels));
  return lines;
}

std::string text_from_state(const Subscriber::Stats& stats) {
  const std::string name(kStateNames[stats.state]);
  if (stats.detail.starts_with(name)) return stats.detail;
  return name + (stats.detail.empty() ? "" : ": " + stats.detail);
}

std::string text_from_timeline(const Timeline& timeline, TimeUs now_us) {
  if (timeline.times_us().size() == 1) return "one pose";
  if (timeline.paused()) return "paused";
  return timeline.until_next_us(now_us) ? "playing" : "at its end";
}

Download download_of(const Subscriber::Stats& stats, double bytes_per_s) {
  Download d{stats.asset_bytes_downloaded + stats.asset_bytes_cached, stats.asset_bytes_total, std::nullopt};
  if (bytes_per_s > 0 && d.bytes < d.total) d.seconds_left = static_cast<double>(d.total - d.bytes) / bytes_per_s;
  return d;
}

std::string connection_line(const Subscriber::Stats& stats, const std::optional<control::StreamInfo>& info,
                            double bytes_per_s, bool has_banner) {
  const Download download = download_of(stats, bytes_per_s);
  const std::string progress = text_from_download(download);
  std::string line(kStateNames[stats.state]);
  switch (stats.state) {
    case Subscriber::State::kDownloading:
      // A clip that is baked here has its own progress.
      line = download.total > 0 ? "downloading model " + progress : stats.detail.empty() ? line : stats.detail;
      break;
    case Subscriber::State::kLive:
      if (!stats.detail.empty()) line = stats.detail;
      if (download.bytes < download.total) line += ": " + progress;
      break;
    default:
      break;
  }
  const bool said = stats.state == Subscriber::State::kLive || stats.state == Subscriber::State::kDownloading;
  const bool more = !said && !has_banner && !stats.detail.empty();
  if (more && stats.detail.compare(0, line.size(), line) == 0) return stats.detail;  // "waiting for a sender at ..."
  if (info && !info->stream.empty()) line += " \xC2\xB7 " + info->stream;
  return more ? line + " \xC2\xB7 " + stats.detail : line;
}

std::string banner_text(const Subscriber::Stats& stats, std::optional<TimeUs> since_us) {
  if (!since_us) return stats.state == Subscriber::State::kRefused ? stats.detail : std::string();
  const std::string since = formatted("no data for %.1f s", static_cast<double>(*since_us) / 1e6);
  switch (stats.state) {
    case Subscriber::State::kLive:
    case Subscriber::State::kDownloading:
      return {};
    case Subscriber::State::kStalled:
      return since + " - the sender is gone, this is its last pose";
    case Subscriber::State::kWaiting:
      return since + " - waiting for a sender";
    case Subscriber::State::kRefused:
      return since + " - refused: " + stats.detail;
    case Subscriber::State::kConnecting:
    case Subscriber::State::kLost:
      return since + " - connection lost" + (stats.detail.empty() ? "" : ": " + stats.detail);
  }
  return {};
}

}  // namespace eigencast
