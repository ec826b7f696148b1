// SPDX-License-Identifier: MIT
#pragma once

#include "common/surface/vector.h"

namespace eigencast::progressive {

/// The sum of w (n . x + d)^2 over planes, as a symmetric 4 x 4 matrix (Garland & Heckbert 1997), and the area it
/// stands for.
struct Quadric {
  double xx = 0, xy = 0, xz = 0, yy = 0, yz = 0, zz = 0;  ///< sum of w n n^T
  double x = 0, y = 0, z = 0;                             ///< sum of w d n
  double constant = 0;                                    ///< sum of w d^2
  double area = 0;

  /// Adds the plane through p with unit normal n and weight w. Does not touch the area.
  void add_plane(const Vec3& n, const Vec3& p, double w) {
    const double d = -dot(n, p);
    xx += w * n[0] * n[0], xy += w * n[0] * n[1], xz += w * n[0] * n[2];
    yy += w * n[1] * n[1], yz += w * n[1] * n[2], zz += w * n[2] * n[2];
    x += w * d * n[0], y += w * d * n[1], z += w * d * n[2];
    constant += w * d * d;
  }

  /// Adds w |x - p|^2, the squared distance from a point. Does not touch the area.
  void add_point(const Vec3& p, double w) {
    xx += w, yy += w, zz += w;
    x -= w * p[0], y -= w * p[1], z -= w * p[2];
    constant += w * dot(p, p);
  }

  Quadric& operator+=(const Quadric& q) {
    xx += q.xx, xy += q.xy, xz += q.xz, yy += q.yy, yz += q.yz, zz += q.zz;
    x += q.x, y += q.y, z += q.z;
    constant += q.constant, area += q.area;
    return *this;
  }

  double at(const Vec3& p) const {
    return p[0] * (xx * p[0] + 2 * (xy * p[1] + xz * p[2] + x)) + p[1] * (yy * p[1] + 2 * (yz * p[2] + y)) +
           p[2] * (zz * p[2] + 2 * z) + constant;
  }
};

/// What moving `from` onto `to` costs, with the two quadrics there. The second term keeps flat regions sampled, which
/// the rest pose alone would empty although they may bend in other poses; it also decides between equal costs.
inline double contraction_cost(const Quadric& from, const Quadric& to, const Vec3& x_from, const Vec3& x_to) {
  constexpr double kDensity = 1e-3;
  const double error = from.at(x_to) + to.at(x_to);
  return (error > 0 ? error : 0) + kDensity * from.area * squared_distance(x_from, x_to);
}

}  // namespace eigencast::progressive
