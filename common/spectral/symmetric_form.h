// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/SparseCore>
#include <exception>

#include "common/spectral/eigenbasis.h"
#include "common/spectral/panels.h"

namespace eigencast {

// The pencil (L, M) as S = M^{-1/2} L M^{-1/2}: the same eigenvalues, orthonormal eigenvectors h = M^{1/2} phi. Private
// to the solvers.

/// Thrown by solvers where progress says to stop.
struct Cancelled : std::exception {};

Eigen::SparseMatrix<double> symmetric_form(const Laplacian& laplacian);

/// S for the kernels; it is symmetric, so its columns are its rows.
SparseRows rows_of(const Eigen::SparseMatrix<double>& S);

/// The kernel of S, known without a solver: M^{1/2} chi_c / sqrt(A_c) for each component c, at most `max` of them.
struct Kernel {
  Panels vectors;
  int count = 0;
};
Kernel kernel_of(const Laplacian& laplacian, int max);

/// Phi = M^{-1/2} H with its residual; certified. REQUIRES: columns of H orthonormal, values ascending.
Eigenbasis eigenbasis_from(const Laplacian& laplacian, const Eigen::SparseMatrix<double>& S, Panels H,
                           Eigen::VectorXd values);

}  // namespace eigencast
