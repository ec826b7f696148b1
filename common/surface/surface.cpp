// SPDX-License-Identifier: MIT
#include "common/surface/surface.h"

#include <algorithm>
#include <cmath>
#include <string>

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

Result<void> check_values(const Surface& surface) {
  const std::size_t n = surface.vertex_count();
  for (std::size_t i = 0; i < n; ++i) {
    const Vec3& p = surface.positions[i];
    if (!std::isfinite(p[0]) || !std::isfinite(p[1]) || !std::isfinite(p[2])) {
      return fail(ErrorCode::kInvalidArgument, "vertex " + std::to_string(i) + " has a coordinate that is not finite");
    }
  }
  for (std::size_t i = 0; i < surface.faces.size(); ++i) {
    for (const std::uint32_t v : surface.faces[i]) {
      if (v < n) continue;
      return fail(ErrorCode::kInvalidArgument, "face " + std::to_string(i) + " refers to vertex " + std::to_string(v) +
                                                   ", but there are " + std::to_string(n));
    }
  }
  return {};
}

Result<void> validate_surface(const Surface& surface) {
  const std::size_t n = surface.vertex_count();
  if (n < 4) {
    return fail(ErrorCode::kInvalidArgument, "a surface of " + std::to_string(n) + " vertices; at least 4 are needed");
  }
  if (n > kMaxSurfaceVertices || surface.faces.size() > kMaxSurfaceFaces) {
    return fail(ErrorCode::kTooLarge, std::to_string(n) + " vertices and " + std::to_string(surface.faces.size()) +
                                          " faces; the limits are " + std::to_string(kMaxSurfaceVertices) + " and " +
                                          std::to_string(kMaxSurfaceFaces));
  }
  return check_values(surface);
}

}  // namespace eigencast
