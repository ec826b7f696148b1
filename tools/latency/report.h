// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "common/core/result.h"
#include "tools/latency/session.h"

namespace eigencast::latency {

inline constexpr int kReportSchema = 1;

/// Name and value, in a fixed order; nothing that names the machine. `url`: of the broker.
std::vector<std::pair<std::string, std::string>> environment(const std::string& version, const std::string& url);

std::string table(const Outcome& outcome);
/// Every number is finite, what is not known is null.
std::string json_report(const Outcome& outcome, const std::string& version);
/// One line per second.
std::string csv_report(const Outcome& outcome);
/// One line per traced pose.
std::string samples_report(const Outcome& outcome);
/// For HdrHistogram's tools; one histogram per second.
std::string hdr_log(const Outcome& outcome);

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
/// Beyond the clocks' uncertainty: then no figure can be trusted.
inline bool sums_are_wrong(const Outcome& outcome) {
  return outcome.sums_wrong > 0 || outcome.impossible > 0;
}

struct Verdict {
  bool holds = false;           ///< The run fails. True where there are too few samples to say.
  std::optional<double> value;  ///< The metric's: microseconds, or a count; nothing: too few samples.
  std::string text;             ///< For people.
};
/// Judges "p99>60ms", "synthetic.p50>30ms", "in_broker.p50>100us", "lost>0". Errors: kInvalidArgument.
Result<Verdict> judged(const std::string& condition, const Outcome& outcome);

/// Errors: kIo, kCorrupt.
Result<std::string> comparison(const std::string& path_a, const std::string& path_b);

}  // namespace eigencast::latency
