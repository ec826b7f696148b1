// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/progressive/prefix.h"

namespace eigencast {

/// What a point cloud needs to be drawn as discs at any level of detail and in any pose, by rows of its prefix order.
///   frame   n: two other rows, both there whenever the row is; with the row itself they span the frame that turns with
///           the surface: t = to the first, m = t x to the second, b = m x t, of unit length. Twice itself: the axes
///   normal  n: unit normal of the rest pose in that frame, (t, b, m)
///   radius  n: of the row's disc when the row appears, at level row + 1 (a row of the base: at the base's level),
///           where it covers, seen along its normal, all that will be split off it and looks the same way
///   parent_radius  n: of the disc of map[row] from then on, until the next row splits off it; 0 for rows of the base
struct PointSplats {
  std::vector<std::array<std::uint32_t, 2>> frame;
  std::vector<std::array<float, 3>> normal;
  std::vector<float> radius, parent_radius;
};

/// positions, normals: in the source's order. Frames are no finer than 16,384 points lie, so that what rounding moves
/// points by does not turn them. O(n log n). REQUIRES: the order is of these points.
PointSplats build_splats(std::span<const Vec3> positions, std::span<const Vec3> normals, const PrefixOrder& order);

/// The unit vectors t, b, m of three points as above, row by row; the axes where the points lie on a line.
std::array<Vec3, 3> frame_from_points(const Vec3& origin, const Vec3& first, const Vec3& second);

}  // namespace eigencast
