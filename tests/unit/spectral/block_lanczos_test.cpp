// SPDX-License-Identifier: MIT
#include "common/spectral/block_lanczos.h"

#include <gtest/gtest.h>

#include <Eigen/Core>

#include "common/spectral/laplacian.h"
#include "support.h"

namespace eigencast {
namespace {

Eigen::MatrixXd matrix_of(const Panels& panels) {
  Eigen::MatrixXd matrix(panels.rows(), panels.columns());
  for (Eigen::Index j = 0; j < matrix.cols(); ++j) {
    for (Eigen::Index i = 0; i < matrix.rows(); ++i) matrix(i, j) = panels.at(i, j);
  }
  return matrix;
}

/// Of a restarted, deflated Lanczos with far more pairs than one subspace was meant for, each pair must still be one.
TEST(BlockLanczos, FindsWhatIsLeftBesidesTheDeflated) {
  const auto laplacian = build_laplacian(make_icosphere(4));
  ASSERT_TRUE(laplacian);
  const Eigen::VectorXd scale = laplacian->mass.cwiseSqrt().cwiseInverse();
  const Eigen::SparseMatrix<double> S = scale.asDiagonal() * laplacian->L * scale.asDiagonal();
  ShiftInvert op(S);
  ASSERT_TRUE(op.factor(20.5));  // among the l = 4 eigenvalues, 20, and l = 5, 30
  const auto first = nearest_eigenpairs(op, 9, 1, {});
  ASSERT_TRUE(first) << first.error().message;
  const auto second = nearest_eigenpairs(op, 20, 2, {&first->vectors});
  ASSERT_TRUE(second) << second.error().message;
  for (const EigenPairs* pairs : {&*first, &*second}) {
    const Eigen::MatrixXd X = matrix_of(pairs->vectors).leftCols(pairs->values.size());
    const Eigen::MatrixXd defect = S * X - X * pairs->values.asDiagonal();
    EXPECT_LE(defect.colwise().norm().maxCoeff(), 1e-6);
    EXPECT_LE((X.transpose() * X - Eigen::MatrixXd::Identity(X.cols(), X.cols())).cwiseAbs().maxCoeff(), 1e-8);
  }
  const Eigen::MatrixXd across = matrix_of(first->vectors).transpose() * matrix_of(second->vectors);
  EXPECT_LE(across.cwiseAbs().maxCoeff(), 1e-8);
  EXPECT_NEAR(first->values.mean(), 20, 0.5);
}

}  // namespace
}  // namespace eigencast
