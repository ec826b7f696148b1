// SPDX-License-Identifier: MIT
#include "tools/latency/report.h"

#include <algorithm>
#include <cstdlib>
#include <nlohmann/json.hpp>

#include "common/core/text.h"
#include "common/net/url.h"

namespace eigencast::latency {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kPercentiles[] = {50, 75, 90, 95, 99, 99.9, 99.99, 100};

unsigned long long n(std::uint64_t v) {
  return v;
}

double ms(TimeUs us) {
  return static_cast<double>(us) / 1000;
}

template <typename T>
Json or_null(const std::optional<T>& value) {
  return value ? Json(*value) : Json(nullptr);
}

std::string percentile_name(double p) {
  return p == 100 ? "max" : formatted("p%g", p);
}

/// Nothing for a one-way value below the clocks' error.
std::optional<std::int64_t> known(const HdrHistogram& h, double p, TimeUs error_us) {
  const auto value = h.reliable_percentile(p);
  return value && *value >= error_us ? value : std::nullopt;
}

std::string row(std::string_view title, const HdrHistogram& h, TimeUs error_us) {
  std::string line = formatted("  %-20.*s", static_cast<int>(title.size()), title.data());
  for (const double p : kPercentiles) {
    const auto value = known(h, p, error_us);
    const bool drowned = error_us > 0 && (h.reliable_percentile(p) || h.negative() > 0);
    line += value ? formatted(" %9.3f", ms(*value)) : formatted(" %9s", drowned ? "unknown" : "-");
  }
  if (error_us > 0) line += formatted("  +- %.3f", ms(error_us));
  return line + "\n";
}

std::string heading(const char* what) {
  std::string line = formatted("%-22s", what);
  for (const double p : kPercentiles) line += formatted(" %9s", percentile_name(p).c_str());
  return line + "\n";
}

std::string stage_rows(const Outcome& o, const std::array<HdrHistogram, kStages>& stages) {
  std::string text;
  for (std::size_t i = 0; i < kStages; ++i) {
    const auto stage = static_cast<Stage>(i);
    if (stage == Stage::kPresent && o.inputs.present.empty()) continue;
    text += row(title_of(stage), stages[i], o.stage_error_us[i]);
  }
  return text;
}

/// Null where the clocks' error is larger than the value; error_us is 0 where all is stamped by one clock.
Json json_from(const HdrHistogram& h, TimeUs error_us = 0) {
  const bool all_known = h.count() > 0 && h.negative() == 0 && h.min() >= error_us;
  Json json{{"count", h.count() + h.negative()}, {"negative_count", h.negative()}, {"error_us", error_us}};
  json["min_us"] = all_known ? Json(h.min()) : Json(nullptr);
  json["mean_us"] = all_known ? Json(h.mean()) : Json(nullptr);
  for (const double p : kPercentiles) json[percentile_name(p) + "_us"] = or_null(known(h, p, error_us));
  return json;
}

Json json_from(const ClockTrack& track) {
  using Point = ClockTrack::Point;
  using Drift = ClockTrack::Drift;
  const auto field = [](const auto& of, auto member) { return of ? Json((*of).*member) : Json(nullptr); };
  const auto best = track.best();
  const auto drift = track.drift();
  return {{"offset_us", field(best, &Point::offset_us)},
          {"error_us", field(best, &Point::error_us)},
          {"drift_ppm", field(drift, &Drift::ppm)},
          {"drift_error_ppm", field(drift, &Drift::error_ppm)}};
}

/// Omits its token: reports are passed on.
std::string without_secrets(const std::string& url) {
  const auto parsed = parse_broker_url(url);
  return parsed ? parsed->shown() : url;
}

/// What the sender is asked for is null where there is none in this process.
Json json_from(const Inputs& in) {
  const auto asked = [&](Json value) { return in.sends() ? value : Json(nullptr); };
  return {{"mode", in.mode},
          {"url", without_secrets(in.url)},
          {"viewer_url", without_secrets(in.viewer_url)},
          {"source", asked(in.source)},
          {"rank", asked(in.rank)},
          {"codec", asked(in.codec)},
          {"rate_hz", asked(in.rate_hz)},
          {"interpolation", in.interpolation},
          {"lod", in.lod},
          {"present", in.present},
          {"clients", in.clients},
          {"duration_s", in.duration_s},
          {"warmup_s", in.warmup_s},
          {"trace_every", in.trace_every},
          {"late_ms", in.late_ms}};
}

Json json_from(const Counts& c) {
  return {{"keys_sent", c.keys_sent},
          {"sends_missed", c.sends_missed},
          {"sends_dropped", c.sends_dropped},
          {"keys_received", c.keys_received},
          {"synthetic_received", c.synthetic_received},
          {"keys_lost", c.keys_lost},
          {"frames_superseded", c.superseded},
          {"overtaken_in_viewer", c.overtaken},
          {"late", c.late},
          {"duplicate", c.duplicate},
          {"out_of_order", c.out_of_order},
          {"traced", c.traced},
          {"trace_incomplete", c.trace_incomplete}};
}

Json json_from(const std::array<HdrHistogram, kStages>& stages, const std::array<TimeUs, kStages>& errors_us) {
  Json json;
  for (std::size_t i = 0; i < kStages; ++i)
    json[std::string(kStageNames[static_cast<Stage>(i)])] = json_from(stages[i], errors_us[i]);
  return json;
}

std::string clock_line(const char* whose, const ClockTrack& track) {
  const auto best = track.best();
  if (!best) return formatted("  %s clock: unknown\n", whose);
  std::string line = formatted("  %s clock: offset %+.3f ms +- %.3f (bound: half the least round trip)", whose,
                               ms(best->offset_us), ms(best->error_us));
  if (const auto drift = track.drift()) line += formatted(", drift %+.1f +- %.1f ppm", drift->ppm, drift->error_ppm);
  return line + "\n";
}

std::string load_lines(const Load::Figures& load) {
  return formatted(
             "light viewers: %llu watching, %llu refused or lost, %llu frames, %llu keys missed, %llu undecodable\n",
             n(load.viewers), n(load.refused), n(load.frames), n(load.keys_missed), n(load.undecodable)) +
         row("pose to socket", load.latency_us, 0) +
         formatted("  their thread: %.0f %% of a core, late by %.3f ms (p99)\n", 100 * load.cpu_share,
                   ms(load.lag_us.percentile(99)));
}

std::string schedule_line(const Outcome& o) {
  return formatted(
      "schedule: %llu sends missed, %llu dropped; sender's thread late by %.3f ms (p99); this process used %.0f %% of "
      "a core\n",
      n(o.counts.sends_missed), n(o.counts.sends_dropped), ms(o.send_lag_us.percentile(99)), 100 * o.cpu_share);
}

std::string warning_lines(const Outcome& o) {
  std::string text;
  for (const Warning& warning : warnings_of(o)) text += "WARNING: " + warning.text + "\n";
  return text;
}

/// Describes a sender alone, which knows nothing of what became of its poses.
std::string sending_table(const Outcome& o) {
  return formatted("publish: %s, r = %d, %g poses/s, %.1f s\nkeys: %llu sent\n", o.inputs.source.c_str(), o.rank,
                   o.key_rate_hz, o.seconds, n(o.counts.keys_sent)) +
         schedule_line(o) + warning_lines(o);
}

}  // namespace

std::string table(const Outcome& o) {
  if (!o.inputs.watches()) return sending_table(o);
  const Counts& c = o.counts;
  std::string text = formatted(
      "%s: %s, %u of %u vertices, r = %d, %s, %s, %.1f s, %.1f kbit/s; times in ms\n\n", o.inputs.mode.c_str(),
      o.inputs.sends() ? o.inputs.source.c_str() : without_secrets(o.inputs.url).c_str(), o.vertices_rebuilt,
      o.vertices, o.rank, o.key_rate_hz > 0 ? formatted("%g poses/s", o.key_rate_hz).c_str() : "poses as they come",
      o.inputs.interpolation > 1 ? formatted("interpolated x %d", o.inputs.interpolation).c_str() : "raw", o.seconds,
      o.kbit_per_s);
  text += heading(o.inputs.present.empty() ? "pose to rebuilt surface" : "pose to picture");
  text += row("keys", o.keys, o.total_error_us);
  if (o.synthetic.count() + o.synthetic.negative() > 0) text += row("synthetic", o.synthetic, o.total_error_us);
  text += row("keys, uncorrected", o.keys_uncorrected, o.total_error_us);
  if (o.age_us.count() > 0) text += row("age of what is shown", o.age_us, 0);
  if (o.key_totals.count() > 0)
    text += "\n" + heading("where a key's time goes") + stage_rows(o, o.key_stages) +
            row("= total, measured", o.key_totals, o.total_error_us);
  if (o.synthetic_totals.count() > 0)
    text += "\n" + heading("a synthetic pose's") + stage_rows(o, o.synthetic_stages) +
            row("= total, measured", o.synthetic_totals, o.total_error_us);
  text += formatted(
      "\nstages add up to the total: %llu poses checked, %llu beyond the clocks' uncertainty, at worst %.3f ms "
      "unexplained; %llu with a stage below zero\n",
      n(o.sums_checked), n(o.sums_wrong), ms(o.worst_unexplained_us), n(o.impossible));
  if (o.held_us.count() > 0 && o.key_rate_hz > 0) {
    const double interval_us = 1e6 / o.key_rate_hz;
    const auto least = static_cast<double>(o.held_us.min()), median = static_cast<double>(o.held_us.percentile(50));
    text += formatted(
        "interpolation held poses %.3f ms at least, %.3f in the median: %.3f and %.3f of a key interval (x %d cannot "
        "do with less than %.3f)\n",
        least / 1000, median / 1000, least / interval_us, median / interval_us, o.inputs.interpolation,
        1 - 1.0 / o.inputs.interpolation);
  }
  if (o.one_machine)
    text +=
        "  the broker is on this machine: all stamps are of one clock; the offsets below are a check, and should be "
        "0\n";
  text += clock_line("sender to broker:", o.sender_clock) + clock_line("viewer to broker:", o.viewer_clock);
  text += formatted(
      "keys: %s%llu received, %llu lost; frames superseded %llu (intended: newer ones overtook them), overtaken in the "
      "viewer %llu; late %llu, duplicate %llu, out of order %llu\n",
      o.inputs.sends() ? formatted("%llu sent, ", n(c.keys_sent)).c_str() : "", n(c.keys_received), n(c.keys_lost),
      n(c.superseded), n(c.overtaken), n(c.late), n(c.duplicate), n(c.out_of_order));
  if (o.inputs.sends()) text += schedule_line(o);
  const auto seconds = [](const std::optional<TimeUs>& us) {
    return us ? formatted("%.3f s", static_cast<double>(*us) / 1e6) : std::string("not seen");
  };
  text += formatted("since subscribing: first surface %s, %swhole surface %s (asset %.2f MB)\n",
                    seconds(o.first_surface_us).c_str(),
                    o.device.empty() ? "" : ("first picture " + seconds(o.first_picture_us) + ", ").c_str(),
                    seconds(o.whole_asset_us).c_str(), static_cast<double>(o.asset_bytes) / 1e6);
  const auto kbit_per_s = [&](double bytes) { return o.seconds > 0 ? bytes * 8e-3 / o.seconds : 0; };
  text += formatted(
      "on the link beside %.1f kbit/s of frames: WebSocket %.1f, TCP and IP %.1f, with TLS %.1f more; memory %.1f kB, "
      "which predicts %llu keys\n",
      o.kbit_per_s, kbit_per_s(o.link.websocket), kbit_per_s(o.link.tcp_ip), kbit_per_s(o.link.tls),
      static_cast<double>(o.memory_bytes) * 1e-3, n(o.recalled));
  if (!o.device.empty()) text += "pictures of " + o.inputs.present + " pixels by " + o.device + "\n";
  if (o.load) text += load_lines(*o.load);
  return text + warning_lines(o);
}

std::string json_report(const Outcome& o, const std::string& version) {
  Json machine;
  for (const auto& [name, value] : environment(version, o.inputs.url)) machine[name] = value;
  machine["graphics"] = o.device.empty() ? Json(nullptr) : Json(o.device);
  const auto traced = [&](const auto& stages, const HdrHistogram& totals) {
    return Json{{"stages", json_from(stages, o.stage_error_us)}, {"total", json_from(totals, o.total_error_us)}};
  };
  Json json{
      {"schema", "eigencast-latency"},
      {"schema_version", kReportSchema},
      {"inputs", json_from(o.inputs)},
      {"environment", std::move(machine)},
      {"one_clock", o.one_clock},
      {"one_machine", o.one_machine},
      {"start_unix_s", o.start_unix_s},
      {"measured_s", o.seconds},
      {"vertices", o.vertices},
      {"vertices_rebuilt", o.vertices_rebuilt},
      {"rank", o.rank},
      {"key_rate_hz", o.key_rate_hz > 0 ? Json(o.key_rate_hz) : Json(nullptr)},
      {"kbit_per_s", o.kbit_per_s},
      {"link_bytes", {{"websocket", o.link.websocket}, {"tcp_ip", o.link.tcp_ip}, {"tls", o.link.tls}}},
      {"memory", {{"keys_recalled", o.recalled}, {"bytes", o.memory_bytes}}},
      {"keys", json_from(o.keys, o.total_error_us)},
      {"synthetic", json_from(o.synthetic, o.total_error_us)},
      {"keys_uncorrected", json_from(o.keys_uncorrected, o.total_error_us)},
      {"age_on_display", json_from(o.age_us)},
      {"traced",
       {{"keys", traced(o.key_stages, o.key_totals)}, {"synthetic", traced(o.synthetic_stages, o.synthetic_totals)}}},
      {"sum_check",
       {{"poses", o.sums_checked},
        {"wrong", o.sums_wrong},
        {"worst_unexplained_us", o.worst_unexplained_us},
        {"impossible", o.impossible},
        {"clock_error_us", *std::max_element(o.stage_error_us.begin(), o.stage_error_us.end())}}},
      {"held", json_from(o.held_us)},
      {"clocks", {{"sender_to_broker", json_from(o.sender_clock)}, {"viewer_to_broker", json_from(o.viewer_clock)}}},
      {"round_trip_us", or_null(o.round_trip_us)},
      {"first_surface_us", or_null(o.first_surface_us)},
      {"first_picture_us", or_null(o.first_picture_us)},
      {"whole_asset_us", or_null(o.whole_asset_us)},
      {"asset_bytes", o.asset_bytes},
      {"counts", json_from(o.counts)},
      {"self", {{"cpu_share", o.cpu_share}, {"send_lag", json_from(o.send_lag_us)}}}};
  if (o.load) {
    json["load"] = {{"viewers", o.load->viewers},
                    {"refused", o.load->refused},
                    {"frames", o.load->frames},
                    {"bytes", o.load->bytes},
                    {"keys_missed", o.load->keys_missed},
                    {"undecodable", o.load->undecodable},
                    {"pose_to_socket", json_from(o.load->latency_us)},
                    {"lag", json_from(o.load->lag_us)},
                    {"cpu_share", o.load->cpu_share},
                    {"was_bottleneck", o.load->was_bottleneck()}};
  }
  json["warnings"] = Json::array();
  for (const Warning& warning : warnings_of(o)) json["warnings"].push_back(warning.text);
  return json.dump(2) + "\n";
}

std::string csv_report(const Outcome& o) {
  std::string text = "start_s,kind,count,p50_us,p90_us,p99_us,max_us\n";
  for (const Interval& interval : o.intervals.all()) {
    for (const auto& [kind, h] : {std::pair{"key", &interval.keys}, std::pair{"synthetic", &interval.synthetic}}) {
      if (h->count() == 0) continue;
      text += formatted("%.3f,%s,%llu", ms(interval.start_us) / 1000, kind, n(h->count()));
      for (const double p : {50, 90, 99, 100}) {
        const auto value = h->reliable_percentile(p);
        text += "," + (value ? std::to_string(*value) : std::string());
      }
      text += "\n";
    }
  }
  return text;
}

std::string samples_report(const Outcome& o) {
  std::string text = "sequence,at,of,capture_us,total_us,unexplained_us,uncertainty_us";
  for (std::size_t i = 0; i < kStages; ++i) text += "," + std::string(kStageNames[static_cast<Stage>(i)]) + "_us";
  text += "\n";
  for (const StagedPose& pose : o.samples) {
    const Envelope& e = pose.envelope;
    text += formatted("%llu,%d,%d", n(e.sequence), int{e.step.at}, int{e.step.of});
    for (const TimeUs us : {e.capture_us, pose.total.us, pose.unexplained_us(), pose.uncertainty_us()})
      text += "," + std::to_string(us);
    for (const Span& span : pose.stages) text += "," + std::to_string(span.us);
    text += "\n";
  }
  return text;
}

std::string hdr_log(const Outcome& o) {
  std::vector<LogInterval> intervals;
  for (const Interval& interval : o.intervals.all()) {
    if (interval.keys.count() > 0) intervals.push_back({"key", interval.start_us, interval.length_us, interval.keys});
    if (interval.synthetic.count() > 0)
      intervals.push_back({"synthetic", interval.start_us, interval.length_us, interval.synthetic});
  }
  return histogram_log(intervals, o.start_unix_s);
}

std::vector<Warning> warnings_of(const Outcome& o) {
  using Code = Warning::Code;
  std::vector<Warning> all;
  const auto warn = [&](bool holds, Code code, const std::string& text) {
    if (holds) all.push_back({code, text});
  };
  const auto is_other_clock = [](const ClockTrack& track) {
    const auto best = track.best();
    return best && std::abs(best->offset_us) > best->error_us;
  };
  const bool watches = o.inputs.watches();
  warn(o.impossible > 0, Code::kImpossible,
       formatted("%llu poses have a stage that took less than no time: do not trust these figures", n(o.impossible)));
  warn(o.sums_wrong > 0, Code::kSumsWrong,
       formatted("THE STAGES DO NOT ADD UP for %llu of %llu poses, by %.3f ms at worst: do not trust these figures",
                 n(o.sums_wrong), n(o.sums_checked), ms(o.worst_unexplained_us)));
  warn(o.one_machine && (is_other_clock(o.sender_clock) || is_other_clock(o.viewer_clock)), Code::kOtherClock,
       "the broker was taken to share our clock, being on loopback, but its clock is another one");
  warn(o.load && o.load->viewers + 1 < o.inputs.clients, Code::kViewersMissing,
       formatted("only %llu of %u light viewers were watching", n(o.load ? o.load->viewers : 0), o.inputs.clients - 1));
  warn(o.load && o.load->was_bottleneck(), Code::kLoadIsBottleneck,
       "the light viewers' own thread was near its limit: the broker may be faster than this");
  warn(o.send_lag_us.count() > 0 && o.send_lag_us.percentile(99) > 5000, Code::kOverloaded,
       "the sender's thread woke late: this machine is overloaded, and the delays include that");
  warn(o.counts.sends_missed > 0, Code::kSendsMissed, "the sender could not hold the rate: see the missed sends");
  warn(o.counts.sends_dropped > 0, Code::kSendsDropped,
       "poses were dropped before they left: the link was behind, or the broker gone");
  warn(!o.trouble.empty(), Code::kStreamEnded, "the stream was not there to the end: " + o.trouble);
  warn(o.reconnects > 0, Code::kReconnected,
       formatted("the viewer's connection broke and came back, times: %llu", n(o.reconnects)));
  warn(watches && o.counts.traced == 0, Code::kNoTraces,
       "no traces came, so there are no stages: are sender and broker of this version?");
  warn(watches && !o.whole_asset_us, Code::kSurfaceIncomplete,
       "the surface had not wholly arrived when measuring began: delays are of a part of it");
  warn(o.counts.keys_lost > 0, Code::kKeysLost, "keys were lost that nothing superseded");
  return all;
}

}  // namespace eigencast::latency
