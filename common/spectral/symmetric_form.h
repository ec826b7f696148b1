// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/SparseCore>
#include <exception>
#include <numbers>
#include <string>

#include "common/core/result.h"
#include "common/spectral/eigenpairs.h"
#include "common/spectral/laplacian.h"
#include "common/spectral/panels.h"

namespace eigencast {

// The pencil (L, M) as S = M^{-1/2} L M^{-1/2}: the same eigenvalues, orthonormal eigenvectors h = M^{1/2} phi, and
// what its solvers share. Private to them.

/// Thrown by solvers where progress says to stop.
struct Cancelled : std::exception {};

Eigen::SparseMatrix<double> symmetric_form(const Laplacian& laplacian);

/// A shift below zero by about a hundredth of a surface's first nonzero eigenvalue, by Weyl's law.
inline double first_shift(double area) {
  return -0.01 * 8 * std::numbers::pi / area;
}

/// The kernel of S, known without a solver: M^{1/2} chi_c / sqrt(A_c) for each component c, at most `max` of them.
struct Kernel {
  Panels vectors;
  int count = 0;
};
Kernel kernel_of(const Laplacian& laplacian, int max);

/// Phi = M^{-1/2} H, orthonormalised, with its residual; certified. `vectors` is what an error calls H. REQUIRES:
/// columns of H nearly orthonormal, those beyond `values` zero; values ascending. Errors: kNumerical.
Result<Eigenbasis> eigenbasis_from(const Laplacian& laplacian, const Eigen::SparseMatrix<double>& S, Panels H,
                                   Eigen::VectorXd values,
                                   const std::string& vectors = "the eigenvectors of the surface");

struct DenseEigen {
  Eigen::VectorXd values;   ///< n, ascending.
  Eigen::MatrixXd vectors;  ///< n x n, column j belongs to values[j].
  bool converged = false;   ///< False: not exact to the last digits.
};

/// A v = lambda v with V^T V = I. A is symmetric; its lower triangle is read.
DenseEigen dense_eigen(const Eigen::MatrixXd& A);

/// A v = lambda B v with V^T B V = I. Both are symmetric, B is positive definite.
DenseEigen dense_eigen(const Eigen::MatrixXd& A, const Eigen::MatrixXd& B);

/// The lowest m eigenpairs by the library Spectra: implicitly restarted Lanczos of one vector (Lehoucq & Sorensen 1996,
/// "Deflation Techniques for an Implicitly Restarted Arnoldi Iteration") about one shift below zero, on Eigen's sparse
/// factor. It shares no numerical code with block_lanczos.h and shift_invert.h. The kernel is projected out. A single
/// vector meets one direction of each eigenspace: pairs that inertia counts as missing are sought in the complement of
/// those found. One thread. Same input, same bits. S is symmetric_form(laplacian).
/// REQUIRES: as solve_eigenbasis. Errors: kNumerical. Throws Cancelled where progress says so, and std::bad_alloc.
Result<Eigenbasis> spectra_eigenbasis(const Laplacian& laplacian, const Eigen::SparseMatrix<double>& S, int m,
                                      const Progress& progress);

/// Bytes that it takes, the factor not counted.
double spectra_bytes(Eigen::Index n, int m);

}  // namespace eigencast
