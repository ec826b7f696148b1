// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

namespace eigencast {

/// Directions as two integers of at most `max` in magnitude: the octahedron |x| + |y| + |z| = 1 unfolded onto a
/// square, its lower half over the corners.
inline std::array<std::int16_t, 2> octahedral_from_normal(const std::array<float, 3>& n, float max) {
  const float size = std::abs(n[0]) + std::abs(n[1]) + std::abs(n[2]);
  float x = n[0] / size, y = n[1] / size;
  if (n[2] < 0) {
    const float folded = (1 - std::abs(y)) * (x < 0 ? -1.0F : 1.0F);
    y = (1 - std::abs(x)) * (y < 0 ? -1.0F : 1.0F);
    x = folded;
  }
  return {static_cast<std::int16_t>(std::lrint(x * max)), static_cast<std::int16_t>(std::lrint(y * max))};
}

inline std::array<float, 3> normal_from_octahedral(std::int16_t u, std::int16_t v, float max) {
  float x = std::clamp(static_cast<float>(u) / max, -1.0F, 1.0F);
  float y = std::clamp(static_cast<float>(v) / max, -1.0F, 1.0F);
  const float z = 1 - std::abs(x) - std::abs(y);
  if (z < 0) {
    const float folded = (1 - std::abs(y)) * (x < 0 ? -1.0F : 1.0F);
    y = (1 - std::abs(x)) * (y < 0 ? -1.0F : 1.0F);
    x = folded;
  }
  const float scale = 1 / std::sqrt(x * x + y * y + z * z);
  return {x * scale, y * scale, z * scale};
}

}  // namespace eigencast
