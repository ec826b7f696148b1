// SPDX-License-Identifier: MIT
#include "common/spectral/shift_invert.h"

#include <metis.h>

#include <Eigen/OrderingMethods>
#include <algorithm>
#include <cmath>
#include <random>

namespace eigencast {
namespace {

constexpr double kBackwardError = 1e-11;  // of a solve; above it pivots were too small

/// False where METIS is out of memory.
bool dissect(const Eigen::SparseMatrix<double>& S, EliminationOrder::PermutationType& inverse) {
  auto n = static_cast<idx_t>(S.rows());
  std::vector<idx_t> first{0}, neighbours;
  first.reserve(static_cast<std::size_t>(n) + 1);
  neighbours.reserve(static_cast<std::size_t>(S.nonZeros()));
  for (int column = 0; column < S.outerSize(); ++column) {
    for (Eigen::SparseMatrix<double>::InnerIterator it(S, column); it; ++it) {
      if (it.row() != column) neighbours.push_back(static_cast<idx_t>(it.row()));
    }
    first.push_back(static_cast<idx_t>(neighbours.size()));
  }
  std::vector<idx_t> order(static_cast<std::size_t>(n)), inverse_order(static_cast<std::size_t>(n));
  if (METIS_NodeND(&n, first.data(), neighbours.data(), nullptr, nullptr, order.data(), inverse_order.data()) !=
      METIS_OK)
    return false;
  inverse.resize(n);
  for (idx_t k = 0; k < n; ++k) inverse.indices()[k] = static_cast<int>(order[static_cast<std::size_t>(k)]);
  return true;
}

}  // namespace

void EliminationOrder::operator()(const Eigen::SparseMatrix<double>& S, PermutationType& inverse) const {
  if (S.rows() >= large_ && dissect(S, inverse)) return;
  Eigen::AMDOrdering<int>()(S, inverse);
}

ShiftInvert::ShiftInvert(const Eigen::SparseMatrix<double>& S) : S_(S) {
  ldlt_.analyzePattern(S);
  Eigen::VectorXd row_sums = Eigen::VectorXd::Zero(S.rows());
  for (int column = 0; column < S.outerSize(); ++column) {
    for (Eigen::SparseMatrix<double>::InnerIterator it(S, column); it; ++it) row_sums[it.row()] += std::abs(it.value());
  }
  norm_ = row_sums.maxCoeff();
  permuted_.resize(static_cast<std::size_t>(S.rows() * kWidth));
  order_ = ldlt_.permutationP().indices();
  if (order_.size() == 0) order_ = Eigen::VectorXi::LinSpaced(S.rows(), 0, static_cast<int>(S.rows()) - 1);
}

bool ShiftInvert::factor(double sigma) {
  sigma_ = sigma;
  ldlt_.setShift(-sigma);
  ldlt_.factorize(S_);
  if (ldlt_.info() != Eigen::Success) return false;
  inverse_pivots_ = ldlt_.vectorD();
  if (!inverse_pivots_.allFinite()) return false;
  negative_ = static_cast<int>((inverse_pivots_.array() < 0).count());
  inverse_pivots_ = inverse_pivots_.cwiseInverse();
  return solves_well();
}

/// Without pivoting the factor of an indefinite matrix may grow; then inertia and solutions are wrong.
bool ShiftInvert::solves_well() {
  std::mt19937 generator(7);
  const Eigen::Index n = rows();
  Eigen::VectorXd b(n);
  for (double& value : b) value = static_cast<double>(generator()) / 4294967296.0 - 0.5;
  std::fill(permuted_.begin(), permuted_.end(), 0.0);
  for (Eigen::Index i = 0; i < n; ++i) permuted_[static_cast<std::size_t>(order_[i] * kWidth)] = b[i];
  solve(permuted_.data());
  Eigen::VectorXd x(n);
  for (Eigen::Index i = 0; i < n; ++i) x[i] = permuted_[static_cast<std::size_t>(order_[i] * kWidth)];
  if (!x.allFinite()) return false;
  const Eigen::VectorXd defect = S_ * x - sigma_ * x - b;
  const double scale = (norm_ + std::abs(sigma_)) * x.lpNorm<Eigen::Infinity>() + b.lpNorm<Eigen::Infinity>();
  return defect.lpNorm<Eigen::Infinity>() <= kBackwardError * scale;
}

void ShiftInvert::apply(const double* from, double* to) {
  apply(from, to, permuted_.data());
  if (callback_) callback_();
}

void ShiftInvert::apply(const double* from, double* to, double* scratch) const {
  scatter_rows(from, order_.data(), rows(), scratch);
  solve(scratch);
  gather_rows(scratch, order_.data(), rows(), to);
}

void ShiftInvert::solve(double* X) const {
  const auto& stored = ldlt_.matrixL().nestedExpression();
  const UnitLower L{stored.outerIndexPtr(), stored.innerIndexPtr(), stored.valuePtr()};
  const PanelFunctions& functions = panel_functions();
  const auto n = static_cast<std::size_t>(rows());
  functions.solve_lower(L, 0, n, X);
  for (std::size_t i = 0; i < n; ++i) {
    const double inverse = inverse_pivots_[static_cast<Eigen::Index>(i)];
    for (std::size_t d = 0; d < kPanelWidth; ++d) X[i * kPanelWidth + d] *= inverse;
  }
  functions.solve_upper(L, 0, n, X);
}

}  // namespace eigencast
