// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/Core>
#include <span>
#include <string>

#include "common/spectral/basis_options.h"
#include "common/spectral/eigenbasis.h"

namespace eigencast {

/// An M-orthonormal basis to stream a surface in.
///   Psi   n x r, Psi^T M Psi = I
///   mass  n
struct Basis {
  Eigen::MatrixXd Psi;
  Eigen::VectorXd mass;
  double area = 0;
  double residual = 0;  ///< See Eigenbasis.
  bool certified = false;
  bool approximate = false;  ///< See Eigenbasis, as for `missed`.
  std::optional<int> missed;
  // Bases of a known motion only:
  int dimensions = 0;  ///< Columns that hold all of it; r may be less.
  Eigen::VectorXd
      rms;  ///< r: root mean square of each coefficient's norm over x, y, z in its poses; empty: none are known.
  double left_out = 0;  ///< Share of the poses' extent (as of KG, weighted by area) that the basis does not hold.
};

/// kHarmonic: the r lowest manifold harmonics. kAugmented (docs/maths.md): 1, x0, y0, z0, then seven harmonics and
/// three products phi_k * (x0, y0, z0) by turns, orthonormalised in that order, so that every prefix is a basis and
/// every affine image of the rest pose is exact. Harmonics replace dependent columns (relative residual below 1e-2). Errors: kInvalidArgument, kNumerical, kCancelled.
Result<Basis> build_basis(const Surface& rest, const Laplacian& laplacian, const BasisOptions& options,
                          const Progress& progress = {});

/// C = Psi^T M X, r x 3. X is n x 3.
Eigen::MatrixXd coefficients_from_positions(const Basis& basis, std::span<const Vec3> positions);
/// X = Psi C, n x 3.
std::vector<Vec3> positions_from_coefficients(const Basis& basis, const Eigen::MatrixXd& C);

}  // namespace eigencast
