// SPDX-License-Identifier: MIT
#include "common/spectral/dense_eigen.h"

#include <Eigen/Eigenvalues>

namespace eigencast {
namespace {

DenseEigen taken_from(const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>& solver) {
  return {solver.eigenvalues(), solver.eigenvectors(), solver.info() == Eigen::Success};
}

}  // namespace

DenseEigen dense_eigen(const Eigen::MatrixXd& A) {
  return taken_from(Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(A));
}

DenseEigen dense_eigen(const Eigen::MatrixXd& A, const Eigen::MatrixXd& B) {
  return taken_from(Eigen::GeneralizedSelfAdjointEigenSolver<Eigen::MatrixXd>(A, B));
}

}  // namespace eigencast
