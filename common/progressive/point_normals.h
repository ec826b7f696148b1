// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/surface/surface.h"

namespace eigencast {

/// Unit normals of a point cloud, n, all on the same side of the surface: outside, where it has one.
/// Each is the direction in which the 16 nearest points spread least. Signs are carried from point to point along a
/// minimum spanning tree of the neighbour graph (Hoppe, DeRose, Duchamp, McDonald, Stuetzle 1992, "Surface
/// reconstruction from unorganized points"); over an edge a normal is mirrored in the plane that halves the edge, which
/// is right for the two sides of a thin sheet, too. No edge joins what is seen from outside with what is seen to be its
/// other side. Each piece is turned to the side from which it is seen; where that is unclear, normals at its outermost
/// points are turned outwards.
/// REQUIRES: positions finite. Coincident points have the same normal. O(n log n).
std::vector<Vec3> oriented_normals(std::span<const Vec3> positions);

namespace progressive {

/// The direction in which the points `around` and `centre` spread least about their mean; of no sign. REQUIRES: around
/// is not empty.
Vec3 normal_from_points(std::span<const Vec3> positions, const Vec3& centre, std::span<const std::uint32_t> around);

}  // namespace progressive
}  // namespace eigencast
