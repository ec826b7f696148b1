// SPDX-License-Identifier: MIT
#pragma once

#include <cassert>
#include <cmath>

#include "common/surface/vector.h"

/// What a hand or a script does to handles: functions of points alone.
namespace eigencast::deform {

/// The axes of a right-handed system: 0 x, 1 y, 2 z.
struct Frame {
  std::size_t axis = 1;     ///< What is turned about, or bent.
  std::size_t towards = 0;  ///< Where the ends of a bend go; not axis.
};

inline Vec3 middle_of(const Box& box) {
  return 0.5 * (box.low + box.high);
}

/// Counter-clockwise seen from the positive end of the axis through `centre`.
inline Vec3 turned(const Vec3& p, const Vec3& centre, std::size_t axis, double angle) {
  const std::size_t u = (axis + 1) % 3, v = (axis + 2) % 3;
  Vec3 q = p;
  const double a = p[u] - centre[u], b = p[v] - centre[v];
  q[u] = centre[u] + std::cos(angle) * a - std::sin(angle) * b;
  q[v] = centre[v] + std::sin(angle) * a + std::cos(angle) * b;
  return q;
}

/// Turns by -angle/2 at the low end of the box's middle line to angle/2 at its high end.
inline Vec3 twisted(const Vec3& p, const Box& box, const Frame& frame, double angle) {
  const double extent = box.high[frame.axis] - box.low[frame.axis];
  const Vec3 middle = middle_of(box);
  if (!(extent > 0)) return p;
  return turned(p, middle, frame.axis, angle * (p[frame.axis] - middle[frame.axis]) / extent);
}

/// Lays the box's middle line on an arc of the same length and of that angle, in the plane of the two axes; its middle
/// and its ends stay about where they were.
inline Vec3 bent(const Vec3& p, const Box& box, const Frame& frame, double angle) {
  assert(frame.towards != frame.axis);
  const double extent = box.high[frame.axis] - box.low[frame.axis];
  if (!(extent > 0) || std::abs(angle) < 1e-9) return p;
  const Vec3 middle = middle_of(box);
  const double radius = extent / angle;
  const double sagitta = radius * (1 - std::cos(angle / 2));
  const double a = (p[frame.axis] - middle[frame.axis]) / radius;
  const double aside = p[frame.towards] - middle[frame.towards];
  Vec3 q = p;
  q[frame.axis] = middle[frame.axis] + (radius - aside) * std::sin(a);
  q[frame.towards] = middle[frame.towards] + radius - (radius - aside) * std::cos(a) - sagitta / 2;
  return q;
}

inline Vec3 scaled(const Vec3& p, const Vec3& centre, const Vec3& by) {
  Vec3 q;
  for (std::size_t axis = 0; axis < 3; ++axis) q[axis] = centre[axis] + by[axis] * (p[axis] - centre[axis]);
  return q;
}

}  // namespace eigencast::deform
