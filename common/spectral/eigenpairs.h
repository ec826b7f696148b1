// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/Core>
#include <functional>
#include <optional>
#include <string_view>

namespace eigencast {

/// Reports how far a long computation is, in [0, 1], and what it does; returns false to cancel. May be empty.
using Progress = std::function<bool(double fraction, std::string_view stage)>;

/// The lowest m eigenpairs of L phi = lambda M phi.
///   Phi          n x m, column j is eigenvector j; Phi^T M Phi = I
///   eigenvalues  m, ascending, lambda_1 = 0
struct Eigenbasis {
  Eigen::MatrixXd Phi;
  Eigen::VectorXd eigenvalues;
  double residual = 0;       ///< max_j ||L phi_j - lambda_j M phi_j||_{M^-1} / max(lambda_j, first nonzero lambda)
  bool certified = false;    ///< No eigenvalue is missing: by inertia at a gap above lambda_m, or all were computed.
  bool approximate = false;  ///< See approximate_eigenbasis: a smooth basis, whose `residual` is large.
  /// Where approximate: eigenvalues missing below the last one, by inertia; empty where there is no factor.
  std::optional<int> missed;
};

}  // namespace eigencast
