// SPDX-License-Identifier: MIT
#include "common/spectral/lanczos.h"

#include <Spectra/SymEigsSolver.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>
#include <string>
#include <vector>

namespace eigencast {
namespace {

constexpr double kTolerance = 1e-10;  // of 1 / (lambda - sigma)
constexpr int kMaxRestarts = 100;
constexpr double kBackwardError = 1e-11;  // of a solve, above which pivots were too small

Eigen::VectorXd random_vector(Eigen::Index n, std::uint32_t seed) {
  std::mt19937 generator(seed);  // its sequence is fixed by the standard; the distributions' are not
  Eigen::VectorXd x(n);
  for (double& value : x) value = static_cast<double>(generator()) / 4294967296.0 - 0.5;
  return x;
}

}  // namespace

ShiftInvert::ShiftInvert(const Eigen::SparseMatrix<double>& S) : S_(S), probe_(random_vector(S.rows(), 7)) {
  ldlt_.analyzePattern(S);
  Eigen::VectorXd row_sums = Eigen::VectorXd::Zero(S.rows());
  for (int column = 0; column < S.outerSize(); ++column) {
    for (Eigen::SparseMatrix<double>::InnerIterator it(S, column); it; ++it) row_sums[it.row()] += std::abs(it.value());
  }
  norm_ = row_sums.maxCoeff();
}

bool ShiftInvert::factor(double sigma) {
  sigma_ = sigma;
  ldlt_.setShift(-sigma);
  ldlt_.factorize(S_);
  if (ldlt_.info() != Eigen::Success) return false;
  const Eigen::VectorXd pivots = ldlt_.vectorD();
  if (!pivots.allFinite()) return false;
  negative_ = static_cast<int>((pivots.array() < 0).count());
  return solves_well();
}

/// Without pivoting an indefinite matrix may make the factor grow, and then neither inertia nor solution mean anything.
bool ShiftInvert::solves_well() const {
  const Eigen::VectorXd x = ldlt_.solve(probe_);
  if (!x.allFinite()) return false;
  const Eigen::VectorXd defect = S_ * x - sigma_ * x - probe_;
  const double scale = (norm_ + std::abs(sigma_)) * x.lpNorm<Eigen::Infinity>() + probe_.lpNorm<Eigen::Infinity>();
  return defect.lpNorm<Eigen::Infinity>() <= kBackwardError * scale;
}

void ShiftInvert::project(Eigen::Ref<Eigen::VectorXd> x) const {
  if (deflated_ == nullptr || deflated_->cols() == 0) return;
  const Eigen::VectorXd along = deflated_->transpose() * x;
  x.noalias() -= *deflated_ * along;
}

void ShiftInvert::perform_op(const double* x, double* y) const {
  Eigen::Map<Eigen::VectorXd> out(y, rows());
  out = ldlt_.solve(Eigen::Map<const Eigen::VectorXd>(x, cols()));
  project(out);
  if (callback_) callback_();
}

Result<EigenPairs> nearest_eigenpairs(ShiftInvert& op, int count, std::uint32_t seed) {
  const auto n = op.rows();
  assert(count >= 1 && count < n);
  const auto subspace = std::min<Eigen::Index>(n, 2 * Eigen::Index{count} + 10);
  Spectra::SymEigsSolver<ShiftInvert> solver(op, count, subspace);
  Eigen::VectorXd start = random_vector(n, seed);
  op.project(start);
  solver.init(start.data());
  const auto converged = solver.compute(Spectra::SortRule::LargestMagn, kMaxRestarts, kTolerance);
  if (converged < count) {
    return fail(ErrorCode::kNumerical, "Lanczos found " + std::to_string(converged) + " of " + std::to_string(count) +
                                           " eigenpairs near " + std::to_string(op.sigma()));
  }
  const Eigen::VectorXd nu = solver.eigenvalues();
  const Eigen::MatrixXd vectors = solver.eigenvectors();
  const Eigen::VectorXd lambda = (op.sigma() + nu.array().inverse()).matrix();
  std::vector<Eigen::Index> order(static_cast<std::size_t>(lambda.size()));
  std::iota(order.begin(), order.end(), Eigen::Index{0});
  std::stable_sort(order.begin(), order.end(), [&](auto a, auto b) { return lambda[a] < lambda[b]; });
  return EigenPairs{lambda(order), vectors(Eigen::all, order)};
}

}  // namespace eigencast
