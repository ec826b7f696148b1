// SPDX-License-Identifier: MIT
#pragma once

#include <optional>

#include "common/core/clock.h"

/// The schemes of docs/maths.md, "Motion": each pose is a weighted sum of keys, in coefficients as in positions. Pure;
/// times in microseconds on one clock.
namespace eigencast {

/// Weights of a pose between the keys `from` and `to`: of these two and of their neighbours.
struct CurveWeights {
  double before = 0, from = 0, to = 0, after = 0;
};

/// The cubic through `from` and `to` whose slope at each of them is that of the parabola through that key and its two
/// neighbours (Overhauser 1968, "Analytic definition of curves and surfaces by parabolic blending"): the spline of
/// Catmull and Rom (1974) for even keys, and exact for parabolas for any keys. With one neighbour it is the parabola
/// through three keys; with none it is linear (Eq. 7 of Zhang, Dou, Zhou, Wu 2013,
/// "Streaming 3D deforming surfaces with dynamic resolution control"). t_us is clamped to the interval.
/// REQUIRES: before_us < from_us < to_us < after_us.
CurveWeights catmull_rom_weights(std::optional<TimeUs> before_us, TimeUs from_us, TimeUs to_us,
                                 std::optional<TimeUs> after_us, TimeUs t_us);

/// How many whole steps (c1 - c2) an estimate `steps` >= 0 key intervals beyond the newest key goes: `steps` itself
/// where damping is 1 (Eq. 9 of the same paper), else damping + damping^2 + ..., linear between whole numbers.
/// 0 < damping <= 1.
double damped_steps(double steps, double damping);

}  // namespace eigencast
