// SPDX-License-Identifier: MIT
#pragma once

#include <span>
#include <utility>
#include <vector>

#include "common/surface/surface.h"

namespace eigencast {

/// Triangles that cover the surface of a point cloud three times on average: each point's star in the Delaunay
/// triangulation of its 30 nearest neighbours, projected on their tangent plane (Sharp & Crane 2020, "A Laplacian for
/// Nonmanifold Triangle Meshes", section 5.7).
struct LocalTriangles {
  std::vector<Face> faces;
  /// (point, the first point that it coincides with): points within 1e-9 of the box's diagonal of an earlier one have no
  /// triangles of their own.
  std::vector<std::pair<std::uint32_t, std::uint32_t>> coincident;
  /// Area of each point's Voronoi cell among those neighbours, in their plane. 0 where the cell is open or reaches beyond
  /// half their radius, so that farther points could cut it, and for coincident points.
  std::vector<double> cell;
};

/// REQUIRES: positions finite, at least 4 of them.
LocalTriangles local_delaunay(std::span<const Vec3> positions);

}  // namespace eigencast
