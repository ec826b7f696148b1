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

Surface square_grid(std::uint32_t side) {
  Surface grid;
  for (std::uint32_t i = 0; i < side * side; ++i)
    grid.positions.push_back(
        {static_cast<double>(i / side) / (side - 1), static_cast<double>(i % side) / (side - 1), 0});
  for (std::uint32_t i = 0; i + side < side * side; ++i) {
    if (i % side + 1 == side) continue;
    grid.faces.push_back({i, i + side, i + 1});
    grid.faces.push_back({i + 1, i + side, i + side + 1});
  }
  return grid;
}

/// S x = lambda x and X^T X = I, relative to the largest entry of S.
void expect_pairs(const Eigen::SparseMatrix<double>& S, const EigenPairs& pairs, double accuracy) {
  const Eigen::MatrixXd X = matrix_of(pairs.vectors).leftCols(pairs.values.size());
  const Eigen::MatrixXd defect = S * X - X * pairs.values.asDiagonal();
  EXPECT_LE(defect.colwise().norm().maxCoeff(), accuracy * S.coeffs().cwiseAbs().maxCoeff());
  EXPECT_LE((X.transpose() * X - Eigen::MatrixXd::Identity(X.cols(), X.cols())).cwiseAbs().maxCoeff(), 1e-8);
}

/// A space of eight vectors a step that is used up after 8 of its 300 dimensions: whole blocks are random ones then.
TEST(BlockLanczos, GoesOnWhereAllThatIsLeftHasOneEigenvalue) {
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

/// What is deflated has the largest eigenvalue of the operator by far, and must not come back by rounding in a long
/// run.
TEST(BlockLanczos, WhatIsDeflatedStaysOut) {
  const Surface grid = square_grid(40);
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
