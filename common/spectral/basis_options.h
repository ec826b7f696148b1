// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "common/core/result.h"

namespace eigencast {

/// The kind of a basis' columns.
enum class BasisKind : std::uint8_t {
  kAugmented,  ///< Harmonics and their products with the rest pose, which it holds; for any motion.
  kHarmonic,   ///< The lowest manifold harmonics; for any motion.
  kRig,        ///< The columns of a skin and its morph targets.
  kCage,       ///< The columns of a cage.
  kPca,        ///< Principal components of poses.
};

/// The solver of the harmonics.
enum class EigenSolver : std::uint8_t {
  kLanczos,  ///< Ours: block Lanczos in bands, for surfaces of any size.
  kSpectra,  ///< The library Spectra: a second opinion for small surfaces (spectra_solver.h).
};

/// By number, as in options and files.
inline constexpr std::array<std::string_view, 5> kBasisNames = {"augmented", "harmonic", "rig", "cage", "pca"};
inline constexpr std::array<std::string_view, 2> kSolverNames = {"lanczos", "spectra"};

constexpr std::string_view name_of(BasisKind kind) {
  return kBasisNames[static_cast<std::size_t>(kind)];
}
constexpr std::string_view name_of(EigenSolver solver) {
  return kSolverNames[static_cast<std::size_t>(solver)];
}
/// Errors: kInvalidArgument.
Result<BasisKind> basis_from_name(std::string_view name);
Result<EigenSolver> solver_from_name(std::string_view name);

/// Whether it is made for one known motion (motion_basis.h).
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
  int rank = 200;  ///< r; lowered to what n allows, which the result's column count says: n/2 - 1, but 4 for
                   ///< an augmented basis, which is what its rest pose needs.
  EigenSolver solver = EigenSolver::kLanczos;
};

}  // namespace eigencast
