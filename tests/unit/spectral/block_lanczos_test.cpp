// SPDX-License-Identifier: MIT
#include "common/spectral/block_lanczos.h"

#include <gtest/gtest.h>

#include <Eigen/Core>

#include "common/spectral/eigenbasis.h"
#include "common/spectral/laplacian.h"
#include "common/spectral/symmetric_form.h"
#include "support.h"

namespace eigencast {
namespace {

/// Restarted and deflated Lanczos, with far more pairs than one subspace is planned for.
TEST(BlockLanczos, FindsPairsBesidesTheDeflated) {
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
    const Eigen::MatrixXd X = matrix_from(pairs->vectors, pairs->values.size());
    const Eigen::MatrixXd defect = S * X - X * pairs->values.asDiagonal();
    EXPECT_LE(defect.colwise().norm().maxCoeff(), 1e-6);
    EXPECT_LE((X.transpose() * X - Eigen::MatrixXd::Identity(X.cols(), X.cols())).cwiseAbs().maxCoeff(), 1e-8);
  }
  const Eigen::MatrixXd across = matrix_from(first->vectors, 9).transpose() * matrix_from(second->vectors, 20);
  EXPECT_LE(across.cwiseAbs().maxCoeff(), 1e-8);
  EXPECT_NEAR(first->values.mean(), 20, 0.5);
}

/// S x = lambda x and X^T X = I, relative to the largest entry of S.
void expect_pairs(const Eigen::SparseMatrix<double>& S, const EigenPairs& pairs, double accuracy) {
  const Eigen::MatrixXd X = matrix_from(pairs.vectors, pairs.values.size());
  const Eigen::MatrixXd defect = S * X - X * pairs.values.asDiagonal();
  EXPECT_LE(defect.colwise().norm().maxCoeff(), accuracy * S.coeffs().cwiseAbs().maxCoeff());
  EXPECT_LE((X.transpose() * X - Eigen::MatrixXd::Identity(X.cols(), X.cols())).cwiseAbs().maxCoeff(), 1e-8);
}

/// The Krylov space is exhausted after 8 of its 300 dimensions: whole blocks become random.
TEST(BlockLanczos, ContinuesWithinASingleEigenvalue) {
  const Eigen::Index n = 400;
  Eigen::SparseMatrix<double> S(n, n);
  for (Eigen::Index i = 0; i < n; ++i) S.insert(i, i) = i < 100 ? 1.0 + 0.01 * static_cast<double>(i) : 1e6;
  S.makeCompressed();
  ShiftInvert op(S);
  ASSERT_TRUE(op.factor(1.503));
  const auto pairs = nearest_eigenpairs(op, 90, 1, {});
  ASSERT_TRUE(pairs) << pairs.error().message;
  expect_pairs(S, *pairs, 1e-9);
}

/// The deflated vectors have the largest eigenvalue by far and must not reappear by rounding in a long run.
TEST(BlockLanczos, DeflatedPairsStayOut) {
  const Surface grid = testing::square_grid(40);
  const auto laplacian = build_laplacian(grid);
  ASSERT_TRUE(laplacian);
  const Eigen::SparseMatrix<double> S = symmetric_form(*laplacian);
  const Kernel kernel = kernel_of(*laplacian, 200);
  ShiftInvert op(S);
  ASSERT_TRUE(op.factor(first_shift(laplacian->area)));
  const auto pairs = nearest_eigenpairs(op, 185, 1, {&kernel.vectors});
  ASSERT_TRUE(pairs) << pairs.error().message;
  expect_pairs(S, *pairs, 1e-11);
}

}  // namespace
}  // namespace eigencast
