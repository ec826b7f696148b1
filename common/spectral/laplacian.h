// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/SparseCore>
#include <cstddef>
#include <optional>

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
  int components = 1;                ///< Before bridging; each would add a zero eigenvalue.
  int bridges = 0;                   ///< Spring edges added so that L has one zero eigenvalue.
  std::optional<std::size_t> flips;  ///< Of edges of the tufted cover, where that was taken.
};

/// What stands in for the Laplacian of a point cloud.
enum class PointsOperator {
  kLocalDelaunay,  ///< Of the triangles of local_delaunay.h, by 3 (Sharp & Crane 2020): a row has some eight entries.
  /// Of point_kernel.h (Liu, Prabhakaran & Guo 2012): a row has 110 to 190, the eigenproblem takes some five times as
  /// long and twice the memory, and eigenvalues come out too low, as (1 - exp(-t lambda)) / t for about t = h^2.
  kPbMhb,
};

struct LaplacianOptions {
  bool bridge = true;  ///< Joins components by weak springs at their nearest vertex pairs.
  /// Of meshes: Delaunay triangles of the tufted cover (intrinsic_triangles.h), as where an edge has three or more
  /// faces: weights are not negative however long and thin the faces are.
  bool delaunay = false;
  PointsOperator points = PointsOperator::kLocalDelaunay;  ///< Of surfaces without faces.
};

/// Mesh: intrinsic cotangent assembly with mollification (Sharp & Crane 2020, "A Laplacian for Nonmanifold Triangle
/// Meshes"), natural boundary; on the tufted cover where the mesh is not manifold. Points: see PointsOperator; those
/// that coincide share a mass and hang on a spring. Errors: kInvalidArgument (see validate_surface), kNumerical (no
/// area at all).
Result<Laplacian> build_laplacian(const Surface& surface, const LaplacianOptions& options = {});

}  // namespace eigencast
