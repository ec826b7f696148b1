// SPDX-License-Identifier: MIT
#pragma once

#include <optional>

#include "common/core/clock.h"

/// The schemes of docs/maths.md, "Motion", as weights: each makes a pose as a weighted sum of keys, so that it acts on
/// coefficients as on positions. Pure; times in microseconds on one clock.
namespace eigencast {

/// What a pose between the keys `from` and `to` takes of these two and of the keys on either side of them.
struct CurveWeights {
  double before = 0, from = 0, to = 0, after = 0;
};

/// Eq. 7 of Zhang, Dou, Zhou, Wu 2013, "Streaming 3D deforming surfaces with dynamic resolution control".
/// REQUIRES: from_us < to_us. t_us is held between the two.
CurveWeights linear_weights(TimeUs from_us, TimeUs to_us, TimeUs t_us);

/// The cubic through `from` and `to` whose slope at each of them is that of the parabola through that key and its two
/// neighbours (Overhauser 1968, "Analytic definition of curves and surfaces by parabolic blending"): the spline of
/// Catmull and Rom (1974) where keys are even, and exact for parabolas also where they are not. A missing neighbour
/// leaves the parabola through the other three keys; with neither it is linear_weights.
/// REQUIRES: before_us < from_us < to_us < after_us, as far as they are there.
CurveWeights catmull_rom_weights(std::optional<TimeUs> before_us, TimeUs from_us, TimeUs to_us,
                                 std::optional<TimeUs> after_us, TimeUs t_us);

/// What a pose between two keys takes of them and of their velocities (per second): the cubic of Hermite, exact for
/// cubics. REQUIRES: from_us < to_us. t_us is held between the two.
struct HermiteWeights {
  double from = 0, to = 0, from_velocity_s = 0, to_velocity_s = 0;
};
HermiteWeights hermite_weights(TimeUs from_us, TimeUs to_us, TimeUs t_us);

/// How many whole steps (c1 - c2) an estimate `steps` >= 0 key intervals beyond the newest key goes: `steps` itself
/// where damping is 1 (Eq. 9 of the same paper), else damping + damping^2 + ..., straight between whole numbers: each
/// interval moves `damping` times as far as the one before. 0 < damping <= 1.
double damped_steps(double steps, double damping);

}  // namespace eigencast
