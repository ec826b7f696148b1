// SPDX-License-Identifier: MIT
#pragma once

#include "common/core/result.h"
#include "common/spectral/basis_options.h"
#include "common/spectral/eigenpairs.h"
#include "common/spectral/laplacian.h"

namespace eigencast {

/// Vertices beyond which solve_eigenbasis() approximates.
inline constexpr Eigen::Index kExactMaxVertices = 150'000;

/// Up to kExactMaxVertices: shift-invert block Lanczos by bands with inertia counts, after Vallet & Levy 2008,
/// "Spectral Geometry Processing with Manifold Harmonics"; a dense solver up to n = 512. Beyond: approximations
/// (multilevel.h), which the result says. Uses the process's threads. The stage that progress reports says how much
/// memory it takes where that is above 1 GB, before it is taken; about 8 n (4 m + 90) bytes for m = 200, half that
/// beyond kExactMaxVertices. Same input, same bits on the same instruction set. REQUIRES: 1 <= m < n / 2. Errors:
/// kNumerical, kCancelled, kInvalidArgument (m too large for n), kTooLarge (memory; more vertices than kSpectra takes).
Result<Eigenbasis> solve_eigenbasis(const Laplacian& laplacian, int m, const Progress& progress = {},
                                    EigenSolver solver = EigenSolver::kLanczos);

/// Solves without approximation, however many vertices. Memory, bits and errors: as solve_eigenbasis.
Result<Eigenbasis> solve_eigenbasis_exactly(const Laplacian& laplacian, int m, const Progress& progress = {});

/// Vertices beyond which `EigenSolver::kSpectra` is refused: its time and memory grow with n m^2 on one thread.
inline constexpr Eigen::Index kSpectraMaxVertices = 20'000;

}  // namespace eigencast
