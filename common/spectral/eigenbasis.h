// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/Core>
#include <functional>
#include <optional>
#include <string_view>

#include "common/core/result.h"
#include "common/spectral/basis_options.h"
#include "common/spectral/laplacian.h"

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

/// Up to 150,000 vertices: shift-invert block Lanczos by bands with inertia counts, after Vallet & Levy 2008, "Spectral
/// Geometry Processing with Manifold Harmonics"; a dense solver up to n = 512. Beyond: approximations (multilevel.h),
/// which the result says. Uses the process's threads. The stage that progress reports says how much memory it takes
/// where that is above 1 GB, before it is taken; about 8 n (4 m + 90) bytes for m = 200, half that beyond 150,000
/// vertices. Same input, same bits on the same instruction set. REQUIRES: 1 <= m < n / 2. Errors: kNumerical,
/// kCancelled, kInvalidArgument (m too large for n), kTooLarge (memory; more vertices than kSpectra takes).
Result<Eigenbasis> solve_eigenbasis(const Laplacian& laplacian, int m, const Progress& progress = {},
                                    EigenSolver solver = EigenSolver::kLanczos);

/// Solves without approximation, however many vertices. Memory, bits and errors: as solve_eigenbasis.
Result<Eigenbasis> solve_eigenbasis_exactly(const Laplacian& laplacian, int m, const Progress& progress = {});

/// Vertices beyond which `EigenSolver::kSpectra` is refused: its time and memory grow with n m^2 on one thread.
inline constexpr Eigen::Index kSpectraMaxVertices = 20'000;

}  // namespace eigencast
