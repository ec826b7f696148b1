// SPDX-License-Identifier: MIT
#include "common/spectral/panels.h"

#include <gtest/gtest.h>

#include <Eigen/Core>

#include "support.h"

namespace eigencast {
namespace {

constexpr Eigen::Index kWidth = kPanelWidth;
using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, kWidth, Eigen::RowMajor>;

Panels random_panels(Eigen::Index rows, Eigen::Index count, unsigned seed) {
  std::mt19937 generator(seed);
  Panels panels(rows);
  for (Eigen::Index j = 0; j < count; ++j) {
    double* panel = panels.append();
    for (Eigen::Index i = 0; i < rows * kWidth; ++i) panel[i] = testing::uniform(generator) - 0.5;
  }
  return panels;
}

Eigen::MatrixXd matrix_of(const Panels& panels) {
  Eigen::MatrixXd matrix(panels.rows(), panels.columns());
  for (Eigen::Index j = 0; j < matrix.cols(); ++j) {
    for (Eigen::Index i = 0; i < matrix.rows(); ++i) matrix(i, j) = panels.at(i, j);
  }
  return matrix;
}

TEST(PanelKernel, EveryInstructionSetAgreesWithEigen) {
  for (const InstructionSet set : instruction_sets()) {
    const PanelFunctions& functions = panel_functions(set);
    for (const Eigen::Index rows : {1, 2, 7, 8, 33, 100}) {
      Panels panels = random_panels(rows, 3, 1);
      const Eigen::MatrixXd all = matrix_of(panels);
      const auto A = all.leftCols(kWidth), B = all.middleCols(kWidth, kWidth), W = all.rightCols(kWidth);
      Eigen::Matrix<double, kWidth, kWidth, Eigen::RowMajor> G;
      G.setConstant(0.25);
      functions.add_gram(panels[0], panels[1], static_cast<std::size_t>(rows), G.data());
      EXPECT_LE((G.array() - 0.25 - (A.transpose() * B).array()).abs().maxCoeff(), 1e-13) << name_of(set);
      functions.add_product(panels[0], G.data(), static_cast<std::size_t>(rows), panels[2]);
      EXPECT_LE((Eigen::Map<RowMajor>(panels[2], rows, kWidth) - (W + A * G)).cwiseAbs().maxCoeff(), 1e-13)
          << name_of(set);
    }
  }
}

TEST(PanelKernel, EveryInstructionSetSolvesTriangles) {
  // Column j holds rows j + 1, j + 2, j + 5 as far as there are any: odd and even numbers of entries.
  const int n = 23;
  Eigen::MatrixXd L = Eigen::MatrixXd::Identity(n, n);
  std::vector<int> begin{0}, row;
  std::vector<double> value;
  for (int j = 0; j < n; ++j) {
    for (const int below : {1, 2, 5}) {
      if (j + below >= n) continue;
      row.push_back(j + below);
      value.push_back(0.3 - 0.05 * (j % 7) + 0.1 * below);
      L(j + below, j) = value.back();
    }
    begin.push_back(static_cast<int>(row.size()));
  }
  const UnitLower lower{begin.data(), row.data(), value.data()};
  for (const InstructionSet set : instruction_sets()) {
    Panels X = random_panels(n, 1, 5);
    const Eigen::MatrixXd right = matrix_of(X);
    panel_functions(set).solve_lower(lower, 0, n, X[0]);
    EXPECT_LE((L * matrix_of(X) - right).cwiseAbs().maxCoeff(), 1e-12) << name_of(set);
    const Eigen::MatrixXd middle = matrix_of(X);
    panel_functions(set).solve_upper(lower, 0, n, X[0]);
    EXPECT_LE((L.transpose() * matrix_of(X) - middle).cwiseAbs().maxCoeff(), 1e-12) << name_of(set);
  }
}

TEST(Panels, ProductsAgreeWithEigen) {
  for (const Eigen::Index rows : {5, 64, 5000}) {
    Panels A = random_panels(rows, 5, 2);
    const Eigen::MatrixXd dense = matrix_of(A);
    Panels W = random_panels(rows, 1, 3);
    const Eigen::MatrixXd w = matrix_of(W);
    const Eigen::MatrixXd along = transposed_product(A, 1, 4, W[0]);
    EXPECT_LE((along - dense.middleCols(8, 24).transpose() * w).cwiseAbs().maxCoeff(), 1e-10);
    subtract_product(A, 1, 4, along, W[0]);
    EXPECT_LE((matrix_of(W) - (w - dense.middleCols(8, 24) * along)).cwiseAbs().maxCoeff(), 1e-9);
    EXPECT_LE((gram(A) - dense.transpose() * dense).cwiseAbs().maxCoeff(), 1e-10);
    const Eigen::MatrixXd turn = Eigen::MatrixXd::Random(40, 16);
    rotate(A, turn);
    EXPECT_EQ(A.count(), 2);
    EXPECT_LE((matrix_of(A) - dense * turn).cwiseAbs().maxCoeff(), 1e-11);
  }
}

}  // namespace
}  // namespace eigencast
