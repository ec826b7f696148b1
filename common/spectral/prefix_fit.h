// SPDX-License-Identifier: MIT
#pragma once

#include "common/spectral/eigenpairs.h"

namespace eigencast {

/// How the prefixes of a basis fit poses of a surface, judged by some of its vertices. Weighted as senders project
/// (docs/adr/0004-fit-between-area-and-vertices.md). Thread-safe once made.
class PrefixFit {
 public:
  ///   rows      N x R: the basis at N vertices
  ///   mass      N: their areas
  ///   poses     N x 3 T: x, y, z of each pose, about the basis' origin
  ///   vertices  n >= N, of the whole surface
  PrefixFit(const Eigen::MatrixXd& rows, const Eigen::VectorXd& mass, const Eigen::MatrixXd& poses, double vertices);

  /// r x 3 T: the coefficients of the poses on the first r columns. REQUIRES: 1 <= r <= R.
  Eigen::MatrixXd coefficients(int r) const;
  /// The mean squared distance of the surface's vertices from what coefficients (r x 3 T) near those of the fit
  /// rebuild. An estimate, without bias by the number of columns.
  double squared_error(const Eigen::MatrixXd& C) const;

 private:
  double poses_squared_, vertices_, all_vertices_;
  Eigen::MatrixXd L_;         ///< Cholesky factor of rows^T W rows.
  Eigen::MatrixXd y_;         ///< L^-1 rows^T W poses
  Eigen::MatrixXd gram_, B_;  ///< rows^T rows, rows^T poses
};

}  // namespace eigencast
