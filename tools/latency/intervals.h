// SPDX-License-Identifier: MIT
#pragma once

#include <vector>

#include "common/core/clock.h"
#include "tools/latency/hdr_histogram.h"

namespace eigencast::latency {

struct Interval {
  TimeUs start_us = 0, length_us = 0;  ///< Since the measurement began.
  HdrHistogram keys, synthetic;
};

/// Second by second; a run of more than kMax seconds by two, by four and so on, so that memory is bounded.
class Intervals {
 public:
  static constexpr std::size_t kMax = 900;

  /// Or the newest, if that is later.
  Interval& at(TimeUs time_us);
  const std::vector<Interval>& all() const { return all_; }

 private:
  void widen();

  TimeUs length_us_ = 1'000'000;
  std::vector<Interval> all_;  ///< Those in which something came, in order; at most kMax.
};

}  // namespace eigencast::latency
