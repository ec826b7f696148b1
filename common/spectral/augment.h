// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/Core>
#include <span>

#include "common/spectral/laplacian.h"
#include "common/surface/surface.h"

namespace eigencast {

/// What an augmented basis is made of. Everything here is in the symmetric form h = M^{1/2} psi, where the inner
/// product is the plain one.
struct Candidates {
  Eigen::MatrixXd affine;     ///< n x (1..4): the constant and what x0, y0, z0 add to it, orthonormal.
  Eigen::MatrixXd harmonics;  ///< n x m, orthonormal, the constant first.
  /// n x 3: x0, y0, z0 about the M-centroid in units of their root mean square; not times M^{1/2}.
  Eigen::MatrixXd rest;
};

/// All but the harmonics.
Candidates candidates_from(std::span<const Vec3> rest, const Eigen::VectorXd& mass);

/// The columns of an augmented basis of `rank`, orthonormal: the affine ones, then seven harmonics and three products
/// phi_k * (x0, y0, z0), k = 2..K, by turns, then harmonics; what depends on those before is passed over. Fewer when
/// the harmonics do not suffice to fill up. Gives from.harmonics up, whose memory it needs.
Eigen::MatrixXd augment(Candidates& from, int K, int rank);

/// How many harmonics, the constant one counted, such a basis takes of a surface, as a coarser one of some thousand
/// vertices says: products of low harmonics are as smooth there. May be wrong; 0 where there is nothing coarser.
int harmonics_on_coarser(std::span<const Vec3> rest, const Laplacian& laplacian, int K, int rank);

}  // namespace eigencast
