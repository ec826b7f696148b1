// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "common/core/result.h"
#include "tools/latency/outcome.h"

namespace eigencast::latency {

inline constexpr int kReportSchema = 1;

/// Where a run was made, so that runs can be compared: name and value, in a fixed order. Nothing that names the
/// machine. `url`: of the broker.
std::vector<std::pair<std::string, std::string>> environment(const std::string& version, const std::string& url);

/// The report for people.
std::string table(const Outcome& outcome);
/// The report as JSON; every number is finite, what is not known is null.
std::string json_report(const Outcome& outcome, const std::string& version);
/// One line per second: keys and synthetic poses apart.
std::string csv_report(const Outcome& outcome);
/// One line per traced pose with all its stages.
std::string samples_report(const Outcome& outcome);
/// The log for HdrHistogram's tools; one histogram per second, tags "key" and "synthetic".
std::string hdr_log(const Outcome& outcome);

/// What does not add up, or makes the figures doubtful.
struct Warning {
  enum class Code {
    kImpossible,
    kSumsWrong,
    kOtherClock,
    kViewersMissing,
    kLoadIsBottleneck,
    kOverloaded,
    kSendsMissed,
    kSendsDropped,
    kStreamEnded,
    kReconnected,
    kNoTraces,
    kSurfaceIncomplete,
    kKeysLost,
  } code;
  std::string text;  ///< For people, a sentence.
};
std::vector<Warning> warnings_of(const Outcome& outcome);
/// True if the stages do not add up to the total within the clocks' uncertainty: then no figure can be trusted.
bool sums_are_wrong(const Outcome& outcome);

/// What a condition of --fail-if says of a run.
struct Verdict {
  bool holds = false;           ///< The run fails. True where there are too few samples to say.
  std::optional<double> value;  ///< Of the metric: microseconds, or a count; nothing: too few samples.
  std::string text;             ///< For people.
};
/// Judges "p99>60ms", "synthetic.p50>30ms", "in_broker.p50>100us", "lost>0". Errors: kInvalidArgument.
Result<Verdict> judged(const std::string& condition, const Outcome& outcome);

/// The table that compares two JSON reports. Errors: kIo, kCorrupt.
Result<std::string> comparison(const std::string& path_a, const std::string& path_b);

}  // namespace eigencast::latency
