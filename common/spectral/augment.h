// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/Core>
#include <span>

#include "common/spectral/laplacian.h"
#include "common/surface/surface.h"

namespace eigencast {

using PositionMap = Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>>;

/// n x 3, without a copy.
PositionMap matrix_from_positions(std::span<const Vec3> positions);

/// Columns that an augmented basis is chosen from, in the symmetric form h = M^{1/2} psi.
struct Candidates {
  Eigen::MatrixXd affine;     ///< n x (1..4), orthonormal: 1, x0, y0, z0 without dependent ones.
  Eigen::MatrixXd harmonics;  ///< n x m, orthonormal, the constant first.
  Eigen::MatrixXd rest;       ///< n x 3: x0, y0, z0 about the M-centroid in units of their rms; not times M^{1/2}.
};

/// Returns all but the harmonics.
Candidates candidates_from(std::span<const Vec3> rest, const Eigen::VectorXd& mass);

/// The orthonormal columns of an augmented basis of `rank` (see build_basis), with products of phi_2 to phi_K. Fewer
/// than `rank` where the harmonics do not suffice. Frees from.harmonics.
Eigen::MatrixXd augment(Candidates& from, int K, int rank);

/// How many harmonics such a basis takes, with the constant, estimated on a coarser surface of some thousand vertices.
/// May be wrong; 0 where there is no coarser surface.
int harmonics_on_coarser(std::span<const Vec3> rest, const Laplacian& laplacian, int K, int rank);

}  // namespace eigencast
