// SPDX-License-Identifier: MIT
#include "common/surface/surface.h"

#include <algorithm>
#include <cmath>

namespace eigencast {

double Box::diagonal() const {
  if (low[0] > high[0] || low[1] > high[1] || low[2] > high[2]) return 0;
  return std::hypot(high[0] - low[0], high[1] - low[1], high[2] - low[2]);
}

Box bounding_box(std::span<const Vec3> positions) {
  Box box;
  if (positions.empty()) return box;
  box.low = box.high = positions[0];
  for (const Vec3& p : positions) {
    for (std::size_t c = 0; c < 3; ++c) {
      box.low[c] = std::min(box.low[c], p[c]);
      box.high[c] = std::max(box.high[c], p[c]);
    }
  }
  return box;
}

}  // namespace eigencast
