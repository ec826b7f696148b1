// SPDX-License-Identifier: MIT
#pragma once

#include <span>
#include <vector>

#include "common/core/clock.h"

namespace eigencast {

/// Coefficients (r x c, row-major) and when they hold.
struct TimedPose {
  TimeUs time_us = 0;
  std::vector<double> coefficients;
};

/// Eq. 7 of Zhang, Dou, Zhou, Wu 2013, "Streaming 3D deforming surfaces with dynamic resolution control":
/// a + u (b - a), value by value. REQUIRES: equal sizes, 0 <= u <= 1.
std::vector<double> interpolate(std::span<const double> a, std::span<const double> b, double u);

/// Eq. 7 with timestamps: u = (t - a.time) / (b.time - a.time), clamped to [0, 1]. REQUIRES: a.time_us < b.time_us.
TimedPose interpolate(const TimedPose& a, const TimedPose& b, TimeUs t);

/// Eq. 9 of the same paper: newer + step (newer - older), step >= 0 counted in key intervals.
std::vector<double> estimate(std::span<const double> older, std::span<const double> newer, double step);

/// Eq. 9 with timestamps. The step is (t - newer.time) / (newer.time - older.time), and t is held at newer.time + max_ahead_us.
/// REQUIRES: older.time_us < newer.time_us, t >= newer.time_us.
TimedPose estimate(const TimedPose& older, const TimedPose& newer, TimeUs t, TimeUs max_ahead_us);

}  // namespace eigencast
