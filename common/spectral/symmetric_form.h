// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/SparseCore>

#include "common/spectral/eigenbasis.h"
#include "common/spectral/panels.h"

namespace eigencast {

// The pencil (L, M) as S = M^{-1/2} L M^{-1/2}: the same eigenvalues, orthonormal eigenvectors h = M^{1/2} phi. Private
// to the solvers.

Eigen::SparseMatrix<double> symmetric_form(const Laplacian& laplacian);

/// S as kernels read it; its columns are its rows.
SparseRows rows_of(const Eigen::SparseMatrix<double>& S);

/// The kernel of S, known without a solver: one indicator for each component, M^{1/2} chi_c / sqrt(A_c). At most
/// `most`.
struct Kernel {
  Panels vectors;
  int count = 0;
};
Kernel kernel_of(const Laplacian& laplacian, int most);

/// Phi = M^{-1/2} H with its residual; certified. REQUIRES: columns of H orthonormal, values ascending.
Eigenbasis eigenbasis_from(const Laplacian& laplacian, const Eigen::SparseMatrix<double>& S, Panels H,
                           Eigen::VectorXd values);

}  // namespace eigencast
