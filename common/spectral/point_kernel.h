// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/spectral/local_delaunay.h"

namespace eigencast {

/// The heat kernel between the points of a cloud, of which its Laplacian is made in Liu, Prabhakaran & Guo 2012,
/// "Point-Based Manifold Harmonics":
///   area   B_i, that of the point's Voronoi cell; where that is open as much as closed cells mostly have where points
///          lie as far apart; 0 of points that coincide with an earlier one, which have no pairs either
///   pairs  each once, a < b, with B_a B_b exp(-|p_a - p_b|^2 / 4 t) / (4 pi t^2), t = h_a h_b
/// h is the mean distance to the six nearest points, so that the kernel is as wide as the points lie apart there, which
/// keeps pairs alike in number where the cloud is dense and where it is thin. A kernel that has sunk to 1e-4 counts as
/// zero, and no point looks at more than its 192 nearest: at most 192 pairs a point.
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
