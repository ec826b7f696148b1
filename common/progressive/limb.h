// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>

#include "common/progressive/neighbours.h"

namespace eigencast::progressive {

/// A disc at x across the unit normal n, and how far its ends are from the nearest points.
class DiscOnLimb {
 public:
  DiscOnLimb(const Vec3& x, const Vec3& n, const Neighbours& neighbours) : x_(x), neighbours_(neighbours) {
    const Vec3 t = unit(cross(n, std::abs(n[0]) < 0.6 ? Vec3{1, 0, 0} : Vec3{0, 1, 0})), s = cross(n, t);
    constexpr double kHalf = std::numbers::sqrt2 / 2;
    ways_ = {t, s, kHalf * (t + s), kHalf * (t - s)};
  }

  /// Two opposite ends lie in the air: it is wider than its limb.
  bool is_wider(double radius) const {
    constexpr double kInAir = 0.53;  // of the radius, to the nearest point
    return any([&](const Vec3& way) { return in_air(radius, way, kInAir) && in_air(radius, -1 * way, kInAir); });
  }
  /// One end does.
  bool is_over_rim(double radius) const {
    constexpr double kOverRim = 0.7;
    return any([&](const Vec3& way) { return in_air(radius, way, kOverRim) || in_air(radius, -1 * way, kOverRim); });
  }
  /// The distance to the farther of the next points on two opposite sides: rings of points round a limb may lie further
  /// apart than their points. 0 where there are none.
  double gap() const {
    constexpr std::size_t kAround = 32;
    constexpr double kWithin = 0.7;  // cosine between a point's direction and the side's
    const auto around = neighbours_.nearest(x_, kAround);
    const auto next = [&](const Vec3& side) {
      const auto is_there = [&](std::uint32_t i) {
        const Vec3 e = neighbours_.position(i) - x_;
        return dot(e, side) > kWithin * length(e);
      };
      const auto found = std::find_if(around.begin(), around.end(), is_there);
      return found == around.end() ? 0 : length(neighbours_.position(*found) - x_);
    };
    double gap = 0;
    for (const Vec3& way : ways_) {
      const double before = next(-1 * way), after = next(way);
      if (before > 0 && after > 0) gap = std::max({gap, before, after});
    }
    return gap;
  }

 private:
  bool any(const auto& condition) const { return std::any_of(ways_.begin(), ways_.end(), condition); }
  bool in_air(double radius, const Vec3& along, double part) const {
    const Vec3 end = x_ + radius * along;
    const auto nearest = neighbours_.nearest(end, 1);
    return !nearest.empty() && length(neighbours_.position(nearest.front()) - end) > part * radius;
  }

  Vec3 x_;
  const Neighbours& neighbours_;
  std::array<Vec3, 4> ways_;
};

}  // namespace eigencast::progressive
