// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cmath>

#include "common/surface/surface.h"

namespace eigencast::progressive {

/// Directions spread evenly over the sphere, along a spiral of the golden angle.
inline std::array<Vec3, 64> all_round() {
  std::array<Vec3, 64> directions{};
  for (std::size_t k = 0; k < directions.size(); ++k) {
    const double y = 1 - (2 * static_cast<double>(k) + 1) / static_cast<double>(directions.size());
    const double angle = 2.399963229728653 * static_cast<double>(k);
    const double r = std::sqrt(1 - y * y);
    directions[k] = {r * std::cos(angle), y, r * std::sin(angle)};
  }
  return directions;
}

}  // namespace eigencast::progressive
