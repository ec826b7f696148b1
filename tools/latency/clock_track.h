// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <optional>
#include <vector>

#include "common/core/clock.h"

namespace eigencast::latency {

/// Estimates of least round trip (common/net/clock_offset.h); a run of more than kMaxPoints is thinned. Not thread-safe.
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

}  // namespace eigencast::latency
