// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <optional>
#include <vector>

#include "common/core/clock.h"
#include "tools/latency/hdr_histogram.h"

namespace eigencast::latency {

/// Estimates of least round trip (common/net/clock_offset.h); more than kMaxPoints are thinned. Not thread-safe.
class ClockTrack {
 public:
  static constexpr std::size_t kMaxPoints = 4096;
  struct Point {
    TimeUs at_us = 0;
    TimeUs offset_us = 0;  ///< Peer's clock minus ours.
    TimeUs error_us = 0;   ///< Bound: half of the round trip.
  };
  struct Drift {
    double ppm = 0;        ///< Microseconds per second.
    double error_ppm = 0;  ///< Bound.
  };

  /// One that is the same as the last is left out.
  void add(const Point& point);
  const std::vector<Point>& points() const { return points_; }
  std::optional<Point> best() const;
  /// Least squares over the points weighted by 1/error^2; nothing below two points that are a second apart.
  std::optional<Drift> drift() const;

 private:
  std::vector<Point> points_;
};

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

/// How old the pose on display is, sampled once a millisecond: what a person sees. Not thread-safe.
class DisplayAge {
 public:
  void show(TimeUs capture_us, TimeUs shown_us);
  const HdrHistogram& ages_us() const { return ages_us_; }

 private:
  struct Shown {
    TimeUs capture_us = 0, since_us = 0;
  };
  std::optional<Shown> shown_;
  HdrHistogram ages_us_;
};

}  // namespace eigencast::latency
