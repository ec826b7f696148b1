// SPDX-License-Identifier: MIT
#include <sys/utsname.h>
#include <unistd.h>

#include <cmath>
#include <cstdlib>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>

#include "common/core/files.h"
#include "common/core/text.h"
#include "tools/latency/report.h"

namespace eigencast::latency {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::uint64_t kMaxReportBytes = 256 << 20;

std::string first_line(const std::string& path) {
  std::ifstream in(path);
  std::string line;
  std::getline(in, line);
  return line.empty() ? "unknown" : line;
}

std::string processor() {
  std::ifstream in("/proc/cpuinfo");
  for (std::string line; std::getline(in, line);)
    if (line.rfind("model name", 0) == 0) return line.substr(line.find(':') + 2);
  return "unknown";
}

/// Null for metrics that are times.
const std::uint64_t* count_of(const std::string& metric, const Counts& counts) {
  if (metric == "lost") return &counts.keys_lost;
  if (metric == "late") return &counts.late;
  return metric == "superseded" ? &counts.superseded : nullptr;
}

struct Condition {
  std::string metric;
  char op = '>';
  double value = 0;  ///< Microseconds, or a count.
};

Result<Condition> parse_condition(const std::string& text) {
  const auto bad = [&](const char* why) {
    return fail(ErrorCode::kInvalidArgument,
                "--fail-if '" + text + "': " + why +
                    "; for example 'p99>60ms', 'synthetic.p50>30ms', 'in_broker.p50>100us', 'lost>0'");
  };
  const auto at = text.find_first_of("<>");
  if (at == std::string::npos || at == 0) return bad("it needs < or >");
  Condition c{text.substr(0, at), text[at], 0};
  char* end = nullptr;
  c.value = std::strtod(text.c_str() + at + 1, &end);
  const std::string unit = end;
  if (end == text.c_str() + at + 1 || !std::isfinite(c.value)) return bad("it needs a number");
  const std::map<std::string, double> units{{"", 1}, {"us", 1}, {"ms", 1e3}, {"s", 1e6}};
  const auto factor = units.find(unit);
  if (factor == units.end()) return bad("the unit must be us, ms or s");
  if (unit.empty() != (count_of(c.metric, {}) != nullptr)) return bad("times have a unit, counts have none");
  c.value *= factor->second;
  return c;
}

const HdrHistogram* histogram_of(const std::string& name, const Outcome& o) {
  if (name.empty() || name == "key") return &o.keys;
  if (name == "synthetic") return &o.synthetic;
  if (name == "age") return &o.age_us;
  for (std::size_t i = 0; i < kStages; ++i) {
    if (name != kStageNames[static_cast<Stage>(i)]) continue;
    return o.key_stages[i].count() > 0 ? &o.key_stages[i] : &o.synthetic_stages[i];
  }
  return nullptr;
}

Result<std::optional<double>> value_of(const std::string& metric, const Outcome& o) {
  if (const std::uint64_t* count = count_of(metric, o.counts)) return std::optional(static_cast<double>(*count));
  const auto unknown = [&] { return fail(ErrorCode::kInvalidArgument, "--fail-if: '" + metric + "' is not known"); };
  const auto dot = metric.find(".p") != std::string::npos ? metric.find(".p") : metric.find(".m");
  const std::string whose = dot == std::string::npos ? "" : metric.substr(0, dot);
  const std::string what = dot == std::string::npos ? metric : metric.substr(dot + 1);
  const HdrHistogram* h = histogram_of(whose, o);
  if (h == nullptr) return unknown();
  if (what == "mean") return h->count() > 0 ? std::optional(h->mean()) : std::nullopt;
  double p = 100;
  if (what != "max") {
    char* end = nullptr;
    p = what.size() > 1 && what[0] == 'p' ? std::strtod(what.c_str() + 1, &end) : -1;
    if (end == nullptr || *end != '\0' || !(p >= 0 && p <= 100)) return unknown();
  }
  const auto value = h->reliable_percentile(p);
  return value ? std::optional(static_cast<double>(*value)) : std::nullopt;
}

/// Empty for other metrics than percentiles.
std::string samples_needed(const std::string& metric) {
  const auto at = metric.rfind('p');
  const double p = at == std::string::npos ? 100 : std::strtod(metric.c_str() + at + 1, nullptr);
  if (!(p > 0 && p < 100)) return {};
  const double needed = HdrHistogram::kSamplesBeyond / (1 - p / 100);
  return formatted(": %s takes %.0f, a run of more seconds (--duration)", metric.substr(at).c_str(),
                   std::ceil(needed - 1e-6));
}

Result<Json> read_report(const std::string& path) {
  const auto text = read_file(path, kMaxReportBytes);
  if (!text) return text.error();
  Json json = Json::parse(*text, nullptr, false);
  const auto says = [&](const char* name, const Json& value) { return json.contains(name) && json.at(name) == value; };
  if (json.is_discarded() || !json.is_object() || !says("schema", "eigencast-latency"))
    return fail(ErrorCode::kCorrupt, path + ": is not a report of eigencast-latency (--json)");
  if (!says("schema_version", kReportSchema))
    return fail(ErrorCode::kCorrupt, path + ": is a report of another version than " + std::to_string(kReportSchema));
  return json;
}

void compare_objects(const char* what, const Json& a, const Json& b, std::string& out) {
  for (const auto& [name, value] : a.items())
    if (!b.contains(name) || b.at(name) != value)
      out += std::string("  ") + what + " differ: " + name + " " + value.dump() + " / " +
             (b.contains(name) ? b.at(name).dump() : "-") + "\n";
}

void compare_histograms(const std::string& title, const Json& a, const Json& b, std::string& out) {
  for (const char* p : {"p50_us", "p90_us", "p99_us", "p99.9_us", "max_us"}) {
    if (!a.contains(p) || !b.contains(p) || !a.at(p).is_number() || !b.at(p).is_number()) continue;
    const double x = a.at(p).get<double>() / 1000, y = b.at(p).get<double>() / 1000;
    out += formatted("  %-28s %-9s %10.3f %10.3f %+10.3f", title.c_str(),
                     std::string(p).substr(0, std::string(p).size() - 3).c_str(), x, y, y - x);
    out += x > 0 ? formatted(" %+7.1f %%\n", 100 * (y - x) / x) : std::string("\n");
  }
}

}  // namespace

std::vector<std::pair<std::string, std::string>> environment(const std::string& version, const std::string& url) {
  utsname name{};
  uname(&name);
  return {{"eigencast_version", version},
          {"kernel", std::string(name.sysname) + " " + name.release},
          {"machine", name.machine},
          {"processor", processor()},
          {"processors_online", std::to_string(sysconf(_SC_NPROCESSORS_ONLN))},
          {"cpu_governor", first_line("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")},
          {"clock_source", first_line("/sys/devices/system/clocksource/clocksource0/current_clocksource")},
          {"tls", url.starts_with("wss:") || url.starts_with("https:") ? "yes" : "no"},
          {"websocket", "no compression, TCP_NODELAY"},
          {"compiler", __VERSION__}};
}

Result<Verdict> judged(const std::string& text, const Outcome& outcome) {
  const auto condition = parse_condition(text);
  if (!condition) return condition.error();
  const auto value = value_of(condition->metric, outcome);
  if (!value) return value.error();
  if (!*value) return Verdict{true, {}, text + ": too few samples to say" + samples_needed(condition->metric)};
  const bool holds = condition->op == '>' ? **value > condition->value : **value < condition->value;
  return Verdict{holds, *value,
                 text + formatted(": it is %g", **value) + (count_of(condition->metric, {}) ? "" : " us")};
}

Result<std::string> comparison(const std::string& path_a, const std::string& path_b) {
  const auto a = read_report(path_a);
  if (!a) return a.error();
  const auto b = read_report(path_b);
  if (!b) return b.error();
  const Json none = Json::object();
  const auto part = [&](const Json& json, const char* name) -> const Json& {
    return json.contains(name) && json.at(name).is_object() ? json.at(name) : none;
  };
  std::string out;
  compare_objects("inputs", part(*a, "inputs"), part(*b, "inputs"), out);
  compare_objects("environments", part(*a, "environment"), part(*b, "environment"), out);
  out += formatted("  %-28s %-9s %10s %10s %10s\n", "ms", "", "A", "B", "B - A");
  for (const char* kind : {"keys", "synthetic"}) compare_histograms(kind, part(*a, kind), part(*b, kind), out);
  for (const char* kind : {"keys", "synthetic"}) {
    const Json &x = part(part(part(*a, "traced"), kind), "stages"), &y = part(part(part(*b, "traced"), kind), "stages");
    for (const auto& [stage, value] : x.items())
      if (y.contains(stage)) compare_histograms(std::string(kind) + " " + stage, value, y.at(stage), out);
  }
  return out;
}

}  // namespace eigencast::latency
