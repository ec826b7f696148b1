// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <nanoflann.hpp>
#include <span>
#include <utility>
#include <vector>

#include "common/surface/surface.h"

/// What operators of point clouds are made from.
namespace eigencast {

/// A point set for nanoflann; borrows the positions.
struct PointSet {
  std::span<const Vec3> positions;
  std::size_t kdtree_get_point_count() const { return positions.size(); }
  double kdtree_get_pt(std::size_t i, std::size_t axis) const { return positions[i][axis]; }
  bool kdtree_get_bbox(auto&) const { return false; }
};

using KdTree =
    nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<double, PointSet>, PointSet, 3, std::uint32_t>;

inline Eigen::Vector3d vector_from(const Vec3& p) {
  return {p[0], p[1], p[2]};
}

/// Triangles that cover the surface of a point cloud three times on average: each point's star in the Delaunay
/// triangulation of its 30 nearest neighbours, projected on their tangent plane (Sharp & Crane 2020, "A Laplacian for
/// Nonmanifold Triangle Meshes", section 5.7).
struct LocalTriangles {
  std::vector<Face> faces;
  /// (point, the first point that it coincides with): points within 1e-9 of the box's diagonal of an earlier one have
  /// no triangles of their own.
  std::vector<std::pair<std::uint32_t, std::uint32_t>> coincident;
  /// Area of each point's Voronoi cell among those neighbours, in their plane. 0 where the cell is open or reaches
  /// beyond half their radius, so that farther points could cut it, and for coincident points.
  std::vector<double> cell;
};

/// REQUIRES: positions finite, at least 4 of them.
LocalTriangles local_delaunay(std::span<const Vec3> positions);

/// The heat kernel between the points of a cloud, after Liu, Prabhakaran & Guo 2012, "Point-Based Manifold Harmonics":
///   area   B_i, of the point's Voronoi cell; of an open cell the usual area at that spacing; 0 of coincident points,
///          which have no pairs
///   pairs  each once, a < b, with B_a B_b exp(-|p_a - p_b|^2 / 4 t) / (4 pi t^2), t = h_a h_b
/// h is the mean distance to the six nearest points, so that dense and thin regions have about as many pairs. The
/// kernel is cut at 1e-4 and at the 192 nearest points.
struct PointKernel {
  struct Pair {
    std::uint32_t a = 0, b = 0;
    double weight = 0;
  };
  std::vector<double> area;
  std::vector<Pair> pairs;
};

/// REQUIRES: `local` is local_delaunay(positions). Uses the process's threads.
PointKernel point_kernel(std::span<const Vec3> positions, const LocalTriangles& local);

}  // namespace eigencast
