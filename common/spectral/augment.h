// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>

#include "common/spectral/laplacian.h"
#include "common/spectral/panels.h"
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

/// Candidates as columns, with products of phi_2 to phi_K, and their Gram matrix: augmented bases (see build_basis) are
/// chosen from them. All k <= K.
class Augmentation {
 public:
  /// Frees from.harmonics.
  Augmentation(Candidates& from, int K);

  /// Columns of a basis of `rank` with products of phi_2 to phi_k: fewer than that where the harmonics do not suffice.
  Eigen::Index columns(int k, int rank) const;
  /// Its rows of some vertices, times M^{1/2}; orthonormal over all vertices but for rounding.
  Eigen::MatrixXd rows(int k, int rank, std::span<const std::uint32_t> vertices) const;
  /// The whole of it, orthonormal. Frees the candidates.
  Eigen::MatrixXd take(int k, int rank);

 private:
  Panels panels_;
  Eigen::Index affine_, harmonics_;  ///< Columns; all others are products.
  Eigen::MatrixXd gram_;
};

/// How many harmonics such a basis takes, with the constant, estimated on a coarser surface of some thousand vertices.
/// May be wrong; 0 where there is no coarser surface.
int harmonics_on_coarser(std::span<const Vec3> rest, const Laplacian& laplacian, int K, int rank);

}  // namespace eigencast
