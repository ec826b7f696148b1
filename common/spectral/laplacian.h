// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/SparseCore>

#include "common/core/result.h"
#include "common/surface/surface.h"

namespace eigencast {

/// The discrete Laplace-Beltrami operator of a surface as the pair (L, M) of L phi = lambda M phi.
///   L     n x n, sparse, symmetric, positive semi-definite; L 1 = 0 (cotangent weights with the 1/2; docs/maths.md)
///   mass  n, diagonal of M, all positive: barycentric vertex areas; unreferenced vertices get 1e-3 of the median
///   area  trace of M
struct Laplacian {
  Eigen::SparseMatrix<double> L;
  Eigen::VectorXd mass;
  double area = 0;
  int components = 1;  ///< Before bridging; each would add a zero eigenvalue.
  int bridges = 0;     ///< Spring edges added so that L has one zero eigenvalue.
};

/// Mesh: intrinsic cotangent assembly with mollification (Sharp & Crane 2020, "A Laplacian for Nonmanifold Triangle
/// Meshes"), natural boundary. Points: the union of local tangent-plane Delaunay triangulations, divided by 3 (same
/// source). Components are joined by weak springs at their nearest vertex pairs when `bridge` is set. Errors:
/// kInvalidArgument (see validate_surface), kNumerical (no area at all).
Result<Laplacian> build_laplacian(const Surface& surface, bool bridge = true);

}  // namespace eigencast
