// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "common/core/result.h"

namespace eigencast {

using Vec3 = std::array<double, 3>;
using Face = std::array<std::uint32_t, 3>;

/// Readers and validate_surface refuse more.
inline constexpr std::size_t kMaxSurfaceVertices = 16'000'000;
inline constexpr std::size_t kMaxSurfaceFaces = 32'000'000;

/// A triangle mesh, or a point cloud when `faces` is empty.
struct Surface {
  std::vector<Vec3> positions;  ///< n x 3, in model units, in the order of the source.
  std::vector<Face> faces;      ///< F x 3, indices into positions, counter-clockwise from outside.

  std::size_t vertex_count() const { return positions.size(); }
  bool is_point_cloud() const { return faces.empty(); }
};

/// An axis-aligned box; `low` above `high` means empty.
struct Box {
  Vec3 low{1, 1, 1};
  Vec3 high{-1, -1, -1};
  double diagonal() const;
};

/// The bounding box of points. Its diagonal ("diag") is the length that errors are stated against.
Box bounding_box(std::span<const Vec3> positions);

/// Indices in range, positions finite. Errors: kInvalidArgument, naming the first offender.
Result<void> check_values(const Surface& surface);

/// check_values, and 4 <= n <= limit. Errors: kInvalidArgument or kTooLarge, naming the first offender.
Result<void> validate_surface(const Surface& surface);

}  // namespace eigencast
