// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "common/core/clock.h"

namespace eigencast::latency {

/// Counts times in log-linear buckets that keep three significant digits from 1 us to an hour, laid out as Gil Tene's
/// HdrHistogram (lowest 1, highest 3.6e9, 3 digits), so that its tools read what encoded() writes.
///
/// Negative values are counted apart: none is clamped or hidden. Not thread-safe. add() allocates at most once per
/// power of two.
class HdrHistogram {
 public:
  static constexpr std::int64_t kHighest = 3'600'000'000;
  static constexpr double kSamplesBeyond = 10;  ///< What reliable_percentile asks for.

  void add(std::int64_t value_us);
  void merge(const HdrHistogram& other);

  std::uint64_t count() const { return count_; }        ///< Of values that are not negative.
  std::uint64_t negative() const { return negative_; }  ///< Of those that are.
  std::int64_t min() const { return count_ == 0 ? 0 : min_; }
  std::int64_t max() const { return max_; }
  double mean() const { return count_ == 0 ? 0 : sum_ / static_cast<double>(count_); }

  /// The highest value equivalent to the p-th percentile of the values that are not negative, at most max().
  /// REQUIRES: 0 <= p <= 100. 0 when empty.
  std::int64_t percentile(double p) const;
  /// The percentile of all values, the negative ones included; nothing where it is one of those, or where fewer than
  /// kSamplesBeyond values lie beyond it, so that it would be a matter of luck. p = 100 is the maximum, which is always
  /// known unless empty.
  std::optional<std::int64_t> reliable_percentile(double p) const;

  /// The percentile spectrum as HdrHistogram's tools plot it (.hgrm), values divided by `unit_us`.
  std::string spectrum(double unit_us) const;
  /// V2 format, deflated, base64: the last column of an HdrHistogram log.
  std::string encoded() const;

 private:
  static constexpr int kSubBucketBits = 11;  // 2,048 sub-buckets: 3 digits.
  static std::size_t index_of(std::int64_t value);
  static std::int64_t highest_of(std::size_t index);

  std::vector<std::uint64_t> counts_;
  std::uint64_t count_ = 0, negative_ = 0;
  std::int64_t min_ = 0, max_ = 0;
  double sum_ = 0, sum_of_squares_ = 0;
};

/// One interval of an HdrHistogram log.
struct LogInterval {
  std::string tag;
  TimeUs start_us = 0;  ///< Since the log's start.
  TimeUs length_us = 0;
  HdrHistogram histogram;
};

/// A log in the format of HistogramLogWriter, version 1.3; values in microseconds, maxima in milliseconds.
std::string histogram_log(const std::vector<LogInterval>& intervals, double start_unix_s);

}  // namespace eigencast::latency
