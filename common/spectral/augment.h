// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/Core>
#include <span>

#include "common/spectral/laplacian.h"
#include "common/surface/surface.h"

namespace eigencast {

/// Columns that an augmented basis is chosen from, in the symmetric form h = M^{1/2} psi, where the inner product is the
/// plain one.
struct Candidates {
  Eigen::MatrixXd affine;     ///< n x (1..4): orthonormal_affine().
  Eigen::MatrixXd harmonics;  ///< n x m, orthonormal, the constant first.
  /// n x 3: x0, y0, z0 about the M-centroid in units of their root mean square; not times M^{1/2}.
  Eigen::MatrixXd rest;
};

/// Without the harmonics.
Candidates candidates_from(std::span<const Vec3> rest, const Eigen::VectorXd& mass);

/// The columns of an augmented basis of `rank`, orthonormal: the affine ones, then seven harmonics and three products
/// phi_k * (x0, y0, z0), k = 2..K, by turns, then harmonics. Skips dependent columns. Fewer than `rank` where the
/// harmonics do not suffice. Frees from.harmonics.
Eigen::MatrixXd augment(Candidates& from, int K, int rank);

/// How many harmonics such a basis takes, with the constant, estimated on a coarser surface of some thousand vertices,
/// where products of low harmonics are as smooth. May be wrong; 0 where there is no coarser surface.
int harmonics_on_coarser(std::span<const Vec3> rest, const Laplacian& laplacian, int K, int rank);

}  // namespace eigencast
