// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/Core>
#include <span>
#include <string>

#include "common/spectral/eigenbasis.h"

namespace eigencast {

enum class BasisKind {
  kHarmonic,
  kAugmented,
  kSpanned,  ///< By columns that are known: of a skin, of a cage (motion_basis.h).
  kLearned,  ///< From poses (motion_basis.h).
};

/// An M-orthonormal basis to stream a surface in.
///   Psi   n x r, Psi^T M Psi = I
///   mass  n
struct Basis {
  BasisKind kind = BasisKind::kAugmented;
  Eigen::MatrixXd Psi;
  Eigen::VectorXd mass;
  double area = 0;
  double residual = 0;  ///< Of the eigenpairs used.
  bool certified = false;
  bool approximate = false;  ///< As of Eigenbasis, with `missed`.
  std::optional<int> missed;
  // Of bases that are made for a known motion:
  int dimensions = 0;  ///< Columns that hold all of it; r may be less.
  Eigen::VectorXd
      rms;  ///< r: root mean square of each coefficient's norm over x, y, z in its poses; empty: none are known.
  double left_out = 0;  ///< Share of the poses' extent (as of KG, weighted by area) that the basis does not hold.
};

struct BasisOptions {
  BasisKind kind = BasisKind::kAugmented;  ///< Or kHarmonic.
  int rank = 200;  ///< r; lowered to what n allows, which the result's column count says: n/2 - 1, but 4 for
                   ///< an augmented basis, which is what its rest pose needs.
};

/// kHarmonic: the r lowest manifold harmonics. kAugmented (docs/maths.md): 1, x0, y0, z0, then seven harmonics and
/// three products phi_k * (x0, y0, z0) by turns, orthonormalised in that order, so that every prefix is a basis and
/// every affine image of the rest pose is exact. Dependent columns (relative residual below 1e-2) are dropped and
/// refilled with harmonics. Errors: kInvalidArgument, kNumerical, kCancelled.
Result<Basis> build_basis(const Surface& rest, const Laplacian& laplacian, const BasisOptions& options,
                          const Progress& progress = {});

/// C = Psi^T M X, r x 3. X is n x 3.
Eigen::MatrixXd coefficients_from_positions(const Basis& basis, std::span<const Vec3> positions);
/// X = Psi C, n x 3.
std::vector<Vec3> positions_from_coefficients(const Basis& basis, const Eigen::MatrixXd& C);

}  // namespace eigencast
