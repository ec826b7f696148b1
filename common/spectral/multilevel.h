// SPDX-License-Identifier: MIT
#pragma once

#include "common/spectral/eigenbasis.h"

namespace eigencast {

struct MultilevelOptions {
  Eigen::Index coarse_vertices = 20000;  ///< Where the eigenproblem is solved exactly, at most.
  int most_steps = 4;                    ///< Of inverse iteration on each level.
  double change = 5e-3;                  ///< Of the sum of eigenvalues below which a step was the last.
};

/// Approximations to the lowest m eigenpairs of a surface of many vertices: eigenvectors of a coarser one,
/// interpolated, then block inverse iteration with Rayleigh-Ritz projection on a fifth more vectors than asked for,
/// until it changes little. A stream needs a smooth orthonormal basis, which this is, not eigenvectors. The result says
/// how good it is: `residual`, and in `missed` how many eigenvalues below the last Ritz value inertia counts too many.
/// Takes 1.2 m vectors, a sparse factor and the result's m. Errors: kNumerical, kCancelled. May throw std::bad_alloc.
Result<Eigenbasis> approximate_eigenbasis(const Laplacian& laplacian, int m, const MultilevelOptions& options = {},
                                          const Progress& progress = {});

/// Bytes that it takes, the result included.
double multilevel_bytes(Eigen::Index n, int m);

}  // namespace eigencast
