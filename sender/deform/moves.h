// SPDX-License-Identifier: MIT
#pragma once

#include <vector>

#include "common/surface/surface.h"

/// What a hand or a script does to handles: functions of points alone.
namespace eigencast::deform {

/// The axes of a right-handed system: 0 x, 1 y, 2 z.
struct Frame {
  std::size_t axis = 1;     ///< What is turned about, or bent.
  std::size_t towards = 0;  ///< Where the ends of a bend go; not axis.
};

/// By -angle/2 at the low end of the box's middle line to angle/2 at its high end.
Vec3 twisted(const Vec3& p, const Box& box, const Frame& frame, double angle);
/// Lays the box's middle line on an arc of the same length and of that angle, in the plane of the two axes; its middle
/// and its ends stay about where they were.
Vec3 bent(const Vec3& p, const Box& box, const Frame& frame, double angle);
/// Counter-clockwise seen from the positive end of the axis through `centre`.
Vec3 turned(const Vec3& p, const Vec3& centre, std::size_t axis, double angle);
Vec3 scaled(const Vec3& p, const Vec3& centre, const Vec3& by);

}  // namespace eigencast::deform
