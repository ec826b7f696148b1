// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "common/spectral/basis_options.h"
#include "common/spectral/eigenbasis.h"
#include "common/spectral/known_motion.h"

namespace eigencast {

/// An M-orthonormal basis to stream a surface in.
///   Psi   n x r, Psi^T M Psi = I
///   mass  n
struct Basis {
  Eigen::MatrixXd Psi;
  Eigen::VectorXd mass;
  double area = 0;
  double residual = 0;  ///< As the next three: see Eigenbasis.
  bool certified = false;
  bool approximate = false;
  std::optional<int> missed;
  // Bases of a known motion only:
  int dimensions = 0;   ///< Columns that hold all of it; r may be less.
  Eigen::VectorXd rms;  ///< r: root mean square of each coefficient's norm over x, y, z in its poses; empty: none.
  double left_out = 0;  ///< Share of the poses' extent (as of KG, weighted by area) that the basis does not hold.
};

/// A basis to choose a prefix of: its values at the vertices of a trial.
struct OfferedBasis {
  int products = 0;      ///< Groups of products phi_k (x0, y0, z0), phi_1 counted: see build_basis; 0: it has none.
  Eigen::MatrixXd rows;  ///< N x R
};
struct BasisShape {
  int rank = 0;      ///< 1 to R.
  int products = 0;  ///< That of an offer.
};
struct BasisTrial {
  std::vector<std::uint32_t> vertices;  ///< N, at which bases are judged.
  /// Chooses among the offers and their prefixes. Its errors end the build.
  std::function<Result<BasisShape>(std::span<const OfferedBasis>)> choose;
};

/// Keeps the columns that the trial chooses; left_out stays that of all. Errors: the trial's.
Result<void> cut_by_trial(Basis& basis, const BasisTrial& trial);

/// kHarmonic: the r lowest manifold harmonics. kAugmented (docs/maths.md): 1, x0, y0, z0, then seven harmonics and
/// three products phi_k * (x0, y0, z0) by turns, orthonormalised in that order, so that every prefix is a basis and
/// every affine image of the rest pose is exact. Harmonics replace dependent columns (relative residual below 1e-2).
/// There are up to ten groups, the constant's counted; a trial is offered ten and twenty of up to options.rank columns.
/// Errors: kInvalidArgument, kNumerical, kCancelled; those of the trial.
Result<Basis> build_basis(const Surface& rest, const Laplacian& laplacian, const BasisOptions& options,
                          const Progress& progress = {}, const BasisTrial* trial = nullptr);

/// A basis for a known motion: the constant, x0, y0, z0, so that every affine image of the rest pose is exact; then
/// M-orthonormal columns, each prefix the best of its length:
///   given columns   their span beyond the affine ones, ordered by the variance of the poses, then by the columns'
///                   reach. Poses made of the columns are exact to float rounding, if all fit in `rank`.
///   no columns      the principal components of the poses' coordinates (Alexa & Mueller 2000, "Representing Animations
///                   by Principal Components")
/// Columns that depend on others to a relative 3e-7 are dropped. Poses are read once; the principal components so far
/// are updated for about forty poses at a time (Levy & Lindenbaum 2000, "Sequential Karhunen-Loeve Basis Extraction and
/// its Application to Images"), so that memory does not grow with the clip. Errors: kInvalidArgument (no columns and
/// fewer than two poses; columns or poses of another surface), kNumerical, kCancelled, kTooLarge; those of the poses.
Result<Basis> build_motion_basis(const Surface& rest, const Laplacian& laplacian, const KnownMotion& motion, int rank,
                                 const Progress& progress = {});

/// C = Psi^T M X, r x 3. X is n x 3.
Eigen::MatrixXd coefficients_from_positions(const Basis& basis, std::span<const Vec3> positions);
/// X = Psi C, n x 3.
std::vector<Vec3> positions_from_coefficients(const Basis& basis, const Eigen::MatrixXd& C);

}  // namespace eigencast
