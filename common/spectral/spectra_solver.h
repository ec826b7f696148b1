// SPDX-License-Identifier: MIT
#pragma once

#include "common/spectral/eigenbasis.h"

namespace eigencast {

/// Vertices beyond which `EigenSolver::kSpectra` is refused: its time and memory grow with n m^2 on one thread.
inline constexpr Eigen::Index kSpectraMaxVertices = 20'000;

/// Bytes that it takes, the factor not counted.
double spectra_bytes(Eigen::Index n, int m);

/// The lowest m eigenpairs by the library Spectra: implicitly restarted Lanczos of one vector (Lehoucq & Sorensen 1996,
/// "Deflation Techniques for an Implicitly Restarted Arnoldi Iteration") about one shift below zero, on Eigen's sparse
/// factor. It shares no numerical code with block_lanczos.h and shift_invert.h. The kernel is projected out. A single
/// vector meets one direction of each eigenspace, so the pairs that inertia counts as missing are sought in the
/// complement of those found. One thread. Same input, same bits.
///   S  symmetric_form(laplacian)
/// REQUIRES: as solve_eigenbasis. Errors: kNumerical. Throws Cancelled where progress says so, and std::bad_alloc.
Result<Eigenbasis> spectra_eigenbasis(const Laplacian& laplacian, const Eigen::SparseMatrix<double>& S, int m,
                                      const Progress& progress);

}  // namespace eigencast
