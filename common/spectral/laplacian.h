// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/SparseCore>
#include <cstddef>
#include <optional>
#include <vector>

#include "common/core/result.h"
#include "common/spectral/basis_options.h"
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
  int components = 1;                ///< Before bridging, as many zero eigenvalues.
  int bridges = 0;                   ///< Spring edges added so that L has one zero eigenvalue.
  std::optional<std::size_t> flips;  ///< Edge flips of the tufted cover, where it was used.
};

struct LaplacianOptions {
  bool bridge = true;  ///< Joins components by weak springs at their nearest vertex pairs.
  /// Meshes: use the tufted cover (intrinsic_triangles.h) even where all edges are manifold. Its weights are not
  /// negative, however long and thin the faces are.
  bool delaunay = false;
  PointsOperator points = PointsOperator::kLocalDelaunay;  ///< Surfaces without faces.
};

/// Mesh: intrinsic cotangent assembly with mollification (Sharp & Crane 2020, "A Laplacian for Nonmanifold Triangle
/// Meshes"), natural boundary; on the tufted cover where the mesh is not manifold. Points: see PointsOperator;
/// coincident ones share a mass. Errors: kInvalidArgument (see validate_surface), kNumerical (no area).
Result<Laplacian> build_laplacian(const Surface& surface, const LaplacianOptions& options = {});

/// The component of each vertex, numbered from 0 by its lowest vertex. A vertex without edges is a component.
struct ComponentLabels {
  std::vector<std::uint32_t> of_vertex;
  std::uint32_t count = 0;
};
ComponentLabels components_from_pattern(const Eigen::SparseMatrix<double>& L);

}  // namespace eigencast
