// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/SparseCore>

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

}  // namespace eigencast
