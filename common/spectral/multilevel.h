// SPDX-License-Identifier: MIT
#pragma once

#include "common/core/result.h"
#include "common/spectral/eigenpairs.h"
#include "common/spectral/laplacian.h"

namespace eigencast {

/// A surface's operator on fewer vertices, and the way back.
///   laplacian  L_c = P^T L P; masses of the aggregates
///   P          n x n_c, rows sum to 1
struct Coarsened {
  Laplacian laplacian;
  Eigen::SparseMatrix<double, Eigen::RowMajor> P;
};

/// About a seventh of the vertices: each aggregate is a vertex and its free neighbours, and one Jacobi step smooths
/// functions on aggregates (Vanek, Mandel, Brezina 1996, "Algebraic multigrid by smoothed aggregation for second and
/// fourth order elliptic problems"). Components stay apart.
Coarsened coarsen(const Laplacian& fine);

struct MultilevelOptions {
  Eigen::Index coarse_vertices = 20000;  ///< Largest level that is solved exactly.
  int max_steps = 4;                     ///< Steps of inverse iteration per level.
  double change = 5e-3;                  ///< Relative change of the sum of eigenvalues that ends the iteration.
};

/// Approximations to the lowest m eigenpairs of a surface of many vertices: eigenvectors of a coarser one,
/// interpolated, then block inverse iteration with Rayleigh-Ritz projection on 1.2 m vectors until it changes little. A
/// stream needs only a smooth basis. Sets `residual` and `missed`. Errors: kNumerical, kCancelled; std::bad_alloc.
Result<Eigenbasis> approximate_eigenbasis(const Laplacian& laplacian, int m, const MultilevelOptions& options = {},
                                          const Progress& progress = {});

/// As smooth, in a fraction of the time: eigenvectors of a surface of some thousand vertices, interpolated and
/// smoothed, and the best of their span (Rayleigh-Ritz). Errors: as solve_eigenbasis().
Result<Eigenbasis> provisional_eigenbasis(const Laplacian& laplacian, int m, const Progress& progress = {});

/// Bytes that it takes, with the result.
double multilevel_bytes(Eigen::Index n, int m);

}  // namespace eigencast
