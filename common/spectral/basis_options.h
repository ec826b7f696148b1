// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <string_view>

#include "common/core/result.h"
#include "common/core/text.h"

namespace eigencast {

enum class BasisKind : std::uint8_t {
  kAugmented,  ///< Harmonics and their products with the rest pose, which it holds; for any motion.
  kHarmonic,   ///< The lowest manifold harmonics; for any motion.
  kRig,        ///< The columns of a skin and its morph targets.
  kCage,       ///< The columns of a cage.
  kPca,        ///< Principal components of poses.
};

enum class EigenSolver : std::uint8_t {
  kLanczos,  ///< Ours: block Lanczos in bands, for surfaces of any size.
  kSpectra,  ///< The library Spectra: a second opinion for small surfaces (spectra_solver.cpp).
};

/// The operator of a point cloud.
enum class PointsOperator : std::uint8_t {
  kLocalDelaunay,  ///< A third of that of local_delaunay() (Sharp & Crane 2020): about eight entries a row.
  /// That of point_kernel() (Liu, Prabhakaran & Guo 2012): 110 to 190 entries a row, five times the time and twice the
  /// memory. Eigenvalues are too low, as (1 - exp(-t lambda)) / t for about t = h^2.
  kPbMhb,
};

/// Names are those in options and files.
inline constexpr EnumNames<BasisKind, 5> kBasisNames{{"augmented", "harmonic", "rig", "cage", "pca"}};
inline constexpr EnumNames<EigenSolver, 2> kSolverNames{{"lanczos", "spectra"}};
inline constexpr EnumNames<PointsOperator, 2> kPointsOperatorNames{{"delaunay", "pb-mhb"}};

constexpr std::string_view name_of(BasisKind kind) {
  return kBasisNames[kind];
}
/// Errors: kInvalidArgument.
Result<BasisKind> basis_from_name(std::string_view name);

/// Whether it is made for one known motion (build_motion_basis).
constexpr bool is_of_motion(BasisKind kind) {
  return kind >= BasisKind::kRig;
}
/// Whether it is made of a motion's columns, which hold the whole motion.
constexpr bool is_of_columns(BasisKind kind) {
  return kind == BasisKind::kRig || kind == BasisKind::kCage;
}
/// Whether it holds the rest pose only as far as its columns reach, so that detail has something to bring back.
constexpr bool leaves_detail(BasisKind kind) {
  return kind == BasisKind::kHarmonic || kind == BasisKind::kPca;
}

struct BasisOptions {
  BasisKind kind = BasisKind::kAugmented;  ///< Or kHarmonic.
  int rank = 200;  ///< r; lowered to what n allows: n/2 - 1, but 4 for an augmented basis, which its rest pose needs.
  EigenSolver solver = EigenSolver::kLanczos;
  bool provisional = false;  ///< Of provisional_eigenbasis(), for the first poses of a stream. Augmented bases only.
};

}  // namespace eigencast
