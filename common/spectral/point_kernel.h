// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/spectral/local_delaunay.h"

namespace eigencast {

/// The heat kernel between the points of a cloud, after Liu, Prabhakaran & Guo 2012, "Point-Based Manifold Harmonics":
///   area   B_i, of the point's Voronoi cell; of an open cell the usual area at that spacing; 0 of coincident points,
///          which have no pairs
///   pairs  each once, a < b, with B_a B_b exp(-|p_a - p_b|^2 / 4 t) / (4 pi t^2), t = h_a h_b
/// h is the mean distance to the six nearest points, so that dense and thin regions have about as many pairs. The kernel
/// is cut at 1e-4 and at the 192 nearest points.
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
