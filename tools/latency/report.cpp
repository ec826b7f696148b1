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

std::string percentile_name(double p) {
  if (p == 100) return "max";
  return formatted("p%g", p);
}

std::string ms(std::optional<std::int64_t> us) {
  return us ? formatted("%9.3f", static_cast<double>(*us) / 1000) : std::string("        -");
}

/// A one-way value that the clocks' error drowns is no value.
std::optional<std::int64_t> known(const HdrHistogram& h, double p, TimeUs error_us) {
  const auto value = h.reliable_percentile(p);
  return value && *value >= error_us ? value : std::nullopt;
}

std::string row(std::string_view title, const HdrHistogram& h, TimeUs error_us) {
  std::string line = formatted("  %-20.*s", static_cast<int>(title.size()), title.data());
  for (const double p : kPercentiles) {
    const bool drowned = h.count() + h.negative() > 0 && error_us > 0 && !known(h, p, error_us) &&
                         (h.reliable_percentile(p) || h.negative() > 0);
    line += drowned ? "   unknown" : " " + ms(known(h, p, error_us));
  }
  if (error_us > 0) line += formatted("  +- %.3f", static_cast<double>(error_us) / 1000);
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
  for (const double p : kPercentiles) {
    const auto value = known(h, p, error_us);
    json[percentile_name(p) + "_us"] = value ? Json(*value) : Json(nullptr);
  }
  return json;
}

Json json_from(const ClockTrack& track) {
  Json json;
  const auto best = track.best();
  json["offset_us"] = best ? Json(best->offset_us) : Json(nullptr);
  json["error_us"] = best ? Json(best->error_us) : Json(nullptr);
  const auto drift = track.drift();
  json["drift_ppm"] = drift ? Json(drift->ppm) : Json(nullptr);
  json["drift_error_ppm"] = drift ? Json(drift->error_ppm) : Json(nullptr);
  return json;
}

/// For reports, which are passed on: without a token that stands in it.
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
          {"form", in.form},
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
    json[std::string(name_of(static_cast<Stage>(i)))] = json_from(stages[i], errors_us[i]);
  return json;
}

std::string clock_line(const char* whose, const ClockTrack& track) {
  const auto best = track.best();
  if (!best) return formatted("  %s clock: unknown\n", whose);
  std::string line = formatted("  %s clock: offset %+.3f ms +- %.3f (bound: half the least round trip)", whose,
                               static_cast<double>(best->offset_us) / 1000, static_cast<double>(best->error_us) / 1000);
  if (const auto drift = track.drift()) line += formatted(", drift %+.1f +- %.1f ppm", drift->ppm, drift->error_ppm);
  return line + "\n";
}

std::string load_lines(const Load::Figures& load) {
  std::string text =
      formatted("light viewers: %llu watching, %llu refused or lost, %llu frames, %llu keys missed, %llu undecodable\n",
                static_cast<unsigned long long>(load.viewers), static_cast<unsigned long long>(load.refused),
                static_cast<unsigned long long>(load.frames), static_cast<unsigned long long>(load.keys_missed),
                static_cast<unsigned long long>(load.undecodable));
  text += row("pose to socket", load.latency_us, 0);
  text += formatted("  their thread: %.0f %% of a core, late by %.3f ms (p99)\n", 100 * load.cpu_share,
                    static_cast<double>(load.lag_us.percentile(99)) / 1000);
  return text;
}

unsigned long long n(std::uint64_t v) {
  return static_cast<unsigned long long>(v);
}

std::string schedule_line(const Outcome& o) {
  return formatted(
      "schedule: %llu sends missed, %llu dropped; sender's thread late by %.3f ms (p99); this process used %.0f %% of "
      "a core\n",
      n(o.counts.sends_missed), n(o.counts.sends_dropped), static_cast<double>(o.send_lag_us.percentile(99)) / 1000,
      100 * o.cpu_share);
}

std::string warnings(const Outcome& o) {
  std::string text;
  for (const std::string& complaint : complaints(o)) text += "WARNING: " + complaint + "\n";
  return text;
}

/// Of a sender alone, which knows nothing of what became of its poses.
std::string sending_table(const Outcome& o) {
  return formatted("publish: %s, r = %d, %g poses/s, %.1f s\nkeys: %llu sent\n", o.inputs.source.c_str(), o.rank,
                   o.key_rate_hz, o.seconds, n(o.counts.keys_sent)) +
         schedule_line(o) + warnings(o);
}

}  // namespace

std::string table(const Outcome& o) {
  if (!o.inputs.watches()) return sending_table(o);
  const Counts& c = o.counts;
  std::string text = formatted(
      "%s: %s, %u of %u vertices, r = %d, %s, %s, %.1f s, %.1f kbit/s; times in ms\n\n", o.inputs.mode.c_str(),
      o.inputs.sends() ? o.inputs.source.c_str() : without_secrets(o.inputs.url).c_str(), o.vertices_rebuilt,
      o.vertices, o.rank, o.key_rate_hz > 0 ? formatted("%g poses/s", o.key_rate_hz).c_str() : "poses as they come",
      o.inputs.interpolation > 1
          ? formatted("interpolated x %d, %s", o.inputs.interpolation, o.inputs.form.c_str()).c_str()
          : "raw",
      o.seconds, o.kbit_per_s);
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
      n(o.sums_checked), n(o.sums_wrong), static_cast<double>(o.worst_unexplained_us) / 1000, n(o.impossible));
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
  if (!o.device.empty()) text += "pictures of " + o.inputs.present + " pixels by " + o.device + "\n";
  if (o.load) text += load_lines(*o.load);
  return text + warnings(o);
}

std::string json_report(const Outcome& o, const std::string& version) {
  Json json;
  json["schema"] = "eigencast-latency";
  json["schema_version"] = kReportSchema;
  json["inputs"] = json_from(o.inputs);
  Json place;
  for (const auto& [name, value] : environment(version, o.inputs.url)) place[name] = value;
  place["graphics"] = o.device.empty() ? Json(nullptr) : Json(o.device);
  json["environment"] = std::move(place);
  json["one_clock"] = o.one_clock;
  json["one_machine"] = o.one_machine;
  json["start_unix_s"] = o.start_unix_s;
  json["measured_s"] = o.seconds;
  json["vertices"] = o.vertices;
  json["vertices_rebuilt"] = o.vertices_rebuilt;
  json["rank"] = o.rank;
  json["key_rate_hz"] = o.key_rate_hz > 0 ? Json(o.key_rate_hz) : Json(nullptr);
  json["kbit_per_s"] = o.kbit_per_s;
  json["keys"] = json_from(o.keys, o.total_error_us);
  json["synthetic"] = json_from(o.synthetic, o.total_error_us);
  json["keys_uncorrected"] = json_from(o.keys_uncorrected, o.total_error_us);
  json["age_on_display"] = json_from(o.age_us);
  json["traced"] = {
      {"keys",
       {{"stages", json_from(o.key_stages, o.stage_error_us)}, {"total", json_from(o.key_totals, o.total_error_us)}}},
      {"synthetic",
       {{"stages", json_from(o.synthetic_stages, o.stage_error_us)},
        {"total", json_from(o.synthetic_totals, o.total_error_us)}}}};
  json["sum_check"] = {{"poses", o.sums_checked},
                       {"wrong", o.sums_wrong},
                       {"worst_unexplained_us", o.worst_unexplained_us},
                       {"impossible", o.impossible},
                       {"clock_error_us", *std::max_element(o.stage_error_us.begin(), o.stage_error_us.end())}};
  json["held"] = json_from(o.held_us);
  json["clocks"] = {{"sender_to_broker", json_from(o.sender_clock)}, {"viewer_to_broker", json_from(o.viewer_clock)}};
  json["round_trip_us"] = o.round_trip_us ? Json(*o.round_trip_us) : Json(nullptr);
  json["first_surface_us"] = o.first_surface_us ? Json(*o.first_surface_us) : Json(nullptr);
  json["first_picture_us"] = o.first_picture_us ? Json(*o.first_picture_us) : Json(nullptr);
  json["whole_asset_us"] = o.whole_asset_us ? Json(*o.whole_asset_us) : Json(nullptr);
  json["asset_bytes"] = o.asset_bytes;
  json["counts"] = json_from(o.counts);
  json["self"] = {{"cpu_share", o.cpu_share}, {"send_lag", json_from(o.send_lag_us)}};
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
  json["warnings"] = complaints(o);
  return json.dump(2) + "\n";
}

std::string csv_report(const Outcome& o) {
  std::string text = "start_s,kind,count,p50_us,p90_us,p99_us,max_us\n";
  const auto line = [&](const Interval& interval, const char* kind, const HdrHistogram& h) {
    if (h.count() == 0) return;
    const auto cell = [&](double p) {
      const auto value = h.reliable_percentile(p);
      return value ? std::to_string(*value) : std::string();
    };
    text += formatted("%.3f,%s,%llu,", static_cast<double>(interval.start_us) / 1e6, kind,
                      static_cast<unsigned long long>(h.count())) +
            cell(50) + "," + cell(90) + "," + cell(99) + "," + cell(100) + "\n";
  };
  for (const Interval& interval : o.intervals.all()) {
    line(interval, "key", interval.keys);
    line(interval, "synthetic", interval.synthetic);
  }
  return text;
}

std::string samples_report(const Outcome& o) {
  std::string text = "sequence,at,of,capture_us,total_us,unexplained_us,uncertainty_us";
  for (std::size_t i = 0; i < kStages; ++i) text += "," + std::string(name_of(static_cast<Stage>(i))) + "_us";
  text += "\n";
  for (const StagedPose& pose : o.samples) {
    const Envelope& e = pose.envelope;
    text += formatted("%llu,%d,%d,%lld,%lld,%lld,%lld", static_cast<unsigned long long>(e.sequence), int{e.step.at},
                      int{e.step.of}, static_cast<long long>(e.capture_us), static_cast<long long>(pose.total.us),
                      static_cast<long long>(pose.unexplained_us()), static_cast<long long>(pose.uncertainty_us()));
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

bool sums_are_wrong(const Outcome& outcome) {
  return outcome.sums_wrong > 0 || outcome.impossible > 0;
}

std::vector<std::string> complaints(const Outcome& o) {
  std::vector<std::string> all;
  if (o.impossible > 0)
    all.push_back(formatted("%llu poses have a stage that took less than no time: do not trust these figures",
                            static_cast<unsigned long long>(o.impossible)));
  if (o.sums_wrong > 0)
    all.push_back(
        formatted("THE STAGES DO NOT ADD UP for %llu of %llu poses, by %.3f ms at worst: do not trust these figures",
                  static_cast<unsigned long long>(o.sums_wrong), static_cast<unsigned long long>(o.sums_checked),
                  static_cast<double>(o.worst_unexplained_us) / 1000));
  for (const ClockTrack* track : {&o.sender_clock, &o.viewer_clock}) {
    const auto best = track->best();
    if (o.one_machine && best && std::abs(best->offset_us) > best->error_us)
      all.push_back("the broker was taken to share our clock, being on loopback, but its clock is another one");
  }
  if (o.load && o.load->viewers + 1 < o.inputs.clients)
    all.push_back(formatted("only %llu of %u light viewers were watching", n(o.load->viewers), o.inputs.clients - 1));
  if (o.load && o.load->was_bottleneck())
    all.push_back("the light viewers' own thread was near its limit: the broker may be faster than this");
  if (o.send_lag_us.count() > 0 && o.send_lag_us.percentile(99) > 5000)
    all.push_back("the sender's thread woke late: this machine is overloaded, and the delays include that");
  if (o.counts.sends_missed > 0) all.push_back("the sender could not hold the rate: see the missed sends");
  if (o.counts.sends_dropped > 0)
    all.push_back("poses were dropped before they left: the link was behind, or the broker gone");
  if (!o.trouble.empty()) all.push_back("the stream was not there to the end: " + o.trouble);
  if (o.reconnects > 0)
    all.push_back(formatted("the viewer's connection broke and came back, times: %llu",
                            static_cast<unsigned long long>(o.reconnects)));
  if (o.inputs.watches() && o.counts.traced == 0)
    all.push_back("no traces came, so there are no stages: is sender and broker of this version?");
  if (o.inputs.watches() && !o.whole_asset_us)
    all.push_back("the surface had not wholly arrived when measuring began: delays are of a part of it");
  if (o.counts.keys_lost > 0) all.push_back("keys were lost that nothing superseded");
  return all;
}

}  // namespace eigencast::latency
