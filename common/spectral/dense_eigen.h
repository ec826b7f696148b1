// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/Core>

/// Eigenpairs of small dense matrices. Eigen's solver takes long to compile, hence one translation unit.
/// Private to common/spectral and its tests.
namespace eigencast {

struct DenseEigen {
  Eigen::VectorXd values;   ///< n, ascending.
  Eigen::MatrixXd vectors;  ///< n x n, column j belongs to values[j].
  bool converged = false;   ///< False: not exact to the last digits.
};

/// A v = lambda v with V^T V = I. A is symmetric; its lower triangle is read.
DenseEigen dense_eigen(const Eigen::MatrixXd& A);

/// A v = lambda B v with V^T B V = I. Both are symmetric, B is positive definite.
DenseEigen dense_eigen(const Eigen::MatrixXd& A, const Eigen::MatrixXd& B);

}  // namespace eigencast
