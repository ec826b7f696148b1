// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "common/core/clock.h"
#include "common/core/histogram.h"

namespace eigencast::latency {

/// Counts from 1 us to an hour, laid out as Gil Tene's HdrHistogram (lowest 1, highest 3.6e9, 3 digits). Not
/// thread-safe.
class HdrHistogram : public Histogram {
 public:
  static constexpr std::int64_t kHighest = 3'600'000'000;
  static constexpr double kSamplesBeyond = 10;  ///< What reliable_percentile asks for.

  HdrHistogram() : Histogram(kPrecisionBits) {}
  void add(std::int64_t value_us) { Histogram::add(std::min(value_us, kHighest)); }

  /// Ranks all values, the negative ones included; nothing where it is one of those, or where fewer than kSamplesBeyond
  /// values lie beyond it, so that it would be a matter of luck. p = 100 is the maximum.
  std::optional<std::int64_t> reliable_percentile(double p) const;

  /// Writes what HdrHistogram's tools plot (.hgrm), values divided by `unit_us`.
  std::string spectrum(double unit_us) const;
  /// V2 format, deflated, base64: the last column of an HdrHistogram log.
  std::string encoded() const;

 private:
  static constexpr int kPrecisionBits = 11;  // 2,048 sub-buckets: 3 digits.
};

struct LogInterval {
  std::string tag;
  TimeUs start_us = 0;  ///< Since the log's start.
  TimeUs length_us = 0;
  HdrHistogram histogram;
};

/// Written like HistogramLogWriter's, version 1.3; values in microseconds, maxima in milliseconds.
std::string histogram_log(const std::vector<LogInterval>& intervals, double start_unix_s);

}  // namespace eigencast::latency
