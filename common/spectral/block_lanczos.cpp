// SPDX-License-Identifier: MIT
#include "common/spectral/block_lanczos.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>
#include <span>
#include <string>
#include <utility>

#include "common/spectral/symmetric_form.h"

namespace eigencast {
namespace {

constexpr double kTolerance = 1e-9;  // of 1 / (lambda - sigma), before the power step that pairs() adds
constexpr double kDigits = 20;       // natural logarithm of what a Krylov space must damp, for a guess of its size
constexpr int kMaxRestarts = 40;
constexpr double kLost = 1e-10;           // remaining share of a column's length that is rounding
constexpr double kShort = 1e-3;           // remaining share below which a column is orthogonalised again
constexpr int kMaxRounds = 8;             // of orthonormalising a block
constexpr int kMaxReplaced = 4 * kWidth;  // columns of one block, repeats counted

using Small = Eigen::Matrix<double, kWidth, kWidth>;

/// The last panel of Q_ is the newest block, not yet multiplied by the operator; T_ = Q^T Op Q of the others.
class BlockLanczos {
 public:
  BlockLanczos(ShiftInvert& op, Eigen::Index wanted, std::uint32_t seed, const std::vector<const Panels*>& deflated)
      : op_(op), n_(op.rows()), wanted_(wanted), random_(seed), deflated_(deflated), Q_(n_) {
    Eigen::Index taken = 0;
    for (const Panels* panels : deflated) taken += panels->columns();
    const Eigen::Index room = std::max<Eigen::Index>((n_ - taken) / kWidth - 1, 1);
    expected_ = std::min<Eigen::Index>(expected_subspace(static_cast<int>(wanted)) / kWidth, room);
    max_steps_ = std::min(2 * expected_, room);
    keep_ = std::min(whole_panels(wanted) / kWidth + 3, max_steps_ - 1);
  }

  Result<EigenPairs> run() {
    double* W = Q_.append();
    for (Eigen::Index i = 0; i < n_ * kWidth; ++i) W[i] = static_cast<double>(random_()) / 4294967296.0 - 0.5;
    orthogonalise(W, 0);
    orthonormalise(W, Eigen::VectorXd::Ones(kWidth));
    Eigen::Index check = expected_;
    for (int restart = 0; restart < kMaxRestarts;) {
      extend();
      if (steps() < check && steps() < max_steps_) continue;
      diagonalise();
      if (worst_defect() <= kTolerance) return pairs();
      check = steps() + further_steps();
      if (steps() < max_steps_) continue;
      restart_from_ritz();
      ++restart;
    }
    return fail(ErrorCode::kNumerical, "Lanczos did not converge to " + std::to_string(wanted_) + " eigenpairs near " +
                                           std::to_string(op_.sigma()));
  }

 private:
  Eigen::Index steps() const { return Q_.count() - 1; }

  /// Projects the panels from `first` on out of W, the newest panel; returns the coefficients.
  Eigen::MatrixXd subtract_along(double* W, Eigen::Index first) const {
    const Eigen::Index end = Q_.count() - 1;
    Eigen::MatrixXd along = transposed_product(Q_, first, end, W);
    subtract_product(Q_, first, end, along, W);
    return along;
  }

  void subtract_deflated(double* W) const {
    for (const Panels* panels : deflated_) {
      subtract_product(*panels, 0, panels->count(), transposed_product(*panels, 0, panels->count(), W), W);
    }
  }

  /// Orthogonalises W against the deflated panels, then those from `first` on, where most of it lies, then all: twice
  /// is enough (Parlett 1980, "The Symmetric Eigenvalue Problem"). Then against the deflated panels again: else
  /// rounding grows until the kernel reappears. Returns the coefficients along the panels from `first` on.
  Eigen::MatrixXd orthogonalise(double* W, Eigen::Index first) const {
    subtract_deflated(W);
    Eigen::MatrixXd along = subtract_along(W, first);
    const Eigen::MatrixXd rest = subtract_along(W, 0);
    along += rest.bottomRows(along.rows());
    subtract_deflated(W);
    return along;
  }

  /// One step: the newest block times the operator becomes a block of T_ and a new newest block.
  void extend() {
    const Eigen::Index j = Q_.count() - 1;
    double* W = Q_.append();
    op_.apply(Q_[j], W);
    const Eigen::VectorXd lengths = panel_gram(W, n_).diagonal().cwiseSqrt();
    // By symmetry only the last two blocks overlap with it; after a restart all Ritz vectors do.
    const Eigen::Index first = j == kept_ ? 0 : j - 1;
    Eigen::MatrixXd along = orthogonalise(W, first);
    T_.conservativeResize((j + 1) * kWidth, (j + 1) * kWidth);
    T_.rightCols(kWidth).setZero();
    T_.bottomRows(kWidth).setZero();
    auto diagonal = along.bottomRows(kWidth);
    diagonal = (0.5 * (diagonal + diagonal.transpose())).eval();
    T_.rightCols(kWidth).bottomRows(along.rows()) = along;
    T_.bottomRows(kWidth).rightCols(along.rows()) = along.transpose();
    coupling_ = orthonormalise(W, lengths);
  }

  /// Cholesky-QR until it changes nothing. Columns that are only rounding become random ones. Returns R.
  Small orthonormalise(double* W, const Eigen::VectorXd& lengths) {
    Small R = Small::Identity();
    bool fresh = true;
    for (int round = 0, replaced = 0; round < kMaxRounds && replaced < kMaxReplaced;) {
      const Small G = panel_gram(W, n_);
      if ((G - Small::Identity()).cwiseAbs().maxCoeff() < 1e-13) break;
      const Eigen::VectorXd least = fresh ? Eigen::VectorXd(kLost * lengths) : Eigen::VectorXd::Constant(kWidth, 1e-7);
      Small upper;
      const Eigen::Index bad = cholesky(G, least, upper);
      if (bad < kWidth) {
        // The column depends on those before it; its random substitute is not part of W.
        const Eigen::VectorXd along =
            upper.topLeftCorner(bad, bad).triangularView<Eigen::Upper>().solve(upper.col(bad).head(bad));
        R.topRows(bad) += along * R.row(bad);
        R.row(bad).setZero();
        replace_by_random(W, bad);
        ++replaced;
        continue;
      }
      ++round;
      multiply_panel(W, n_, upper.triangularView<Eigen::Upper>().solve(Small::Identity()));
      R = upper * R;
      if (fresh && (upper.diagonal().array() < kShort * lengths.array()).any()) orthogonalise(W, 0);
      fresh = false;
    }
    return R;
  }

  /// G = upper^T upper. Returns the first column whose remaining length is below `least`, or kWidth.
  static Eigen::Index cholesky(const Small& G, const Eigen::VectorXd& least, Small& upper) {
    upper.setZero();
    for (Eigen::Index k = 0; k < kWidth; ++k) {
      const double left = G(k, k) - upper.col(k).head(k).squaredNorm();
      if (!(left > least[k] * least[k]) || !(left > 1e-15 * G(k, k))) return k;
      upper(k, k) = std::sqrt(left);
      for (Eigen::Index l = k + 1; l < kWidth; ++l) {
        upper(k, l) = (G(k, l) - upper.col(k).head(k).dot(upper.col(l).head(k))) / upper(k, k);
      }
      for (Eigen::Index l = k + 1; l < kWidth; ++l) upper(l, k) = 0;
    }
    return kWidth;
  }

  void replace_by_random(double* W, Eigen::Index column) {
    for (Eigen::Index i = 0; i < n_; ++i) {
      W[i * kWidth + column] = static_cast<double>(random_()) / 4294967296.0 - 0.5;
    }
    orthogonalise(W, 0);
  }

  void diagonalise() {
    DenseEigen pairs = dense_eigen(T_);
    theta_ = std::move(pairs.values);
    Y_ = std::move(pairs.vectors);
    order_.resize(static_cast<std::size_t>(theta_.size()));
    std::iota(order_.begin(), order_.end(), Eigen::Index{0});
    std::stable_sort(order_.begin(), order_.end(),
                     [&](auto a, auto b) { return std::abs(theta_[a]) > std::abs(theta_[b]); });
  }

  /// The largest || Op x - theta x || / |theta| of the wanted Ritz pairs, as the recurrence gives it.
  double worst_defect() const {
    if (static_cast<Eigen::Index>(order_.size()) < wanted_) return 1;
    double worst = 0;
    for (const Eigen::Index k : std::span(order_).first(static_cast<std::size_t>(wanted_))) {
      worst = std::max(worst, (coupling_ * Y_.col(k).tail(kWidth)).norm() / std::abs(theta_[k]));
    }
    return worst;
  }

  /// Defects shrink geometrically, by about e^(kDigits) over the steps that do not go into the pairs themselves.
  Eigen::Index further_steps() const {
    const double missing = std::log(std::clamp(worst_defect() / kTolerance, 1.0, 1e10));
    const double rate = kDigits / static_cast<double>(std::max<Eigen::Index>(expected_ - wanted_ / kWidth, 1));
    return std::max<Eigen::Index>(1, static_cast<Eigen::Index>(std::ceil(0.8 * missing / rate)));
  }

  void restart_from_ritz() {
    const Eigen::Index p = T_.rows(), kept = keep_ * kWidth;
    Eigen::MatrixXd turn = Eigen::MatrixXd::Zero(p + kWidth, kept + kWidth);
    T_ = Eigen::MatrixXd::Zero(kept, kept);
    for (Eigen::Index j = 0; j < kept; ++j) {
      const Eigen::Index from = order_[static_cast<std::size_t>(j)];
      turn.col(j).head(p) = Y_.col(from);
      T_(j, j) = theta_[from];
    }
    turn.bottomRightCorner(kWidth, kWidth).setIdentity();
    rotate(Q_, turn);
    kept_ = keep_;
  }

  /// The wanted pairs, ascending. One power step more than Ritz vectors comes free: Op x is in the basis.
  EigenPairs pairs() {
    const Eigen::Index p = T_.rows();
    std::vector<Eigen::Index> chosen(order_.begin(), order_.begin() + wanted_);
    const auto lambda = [&](Eigen::Index i) { return op_.sigma() + 1 / theta_[i]; };
    std::stable_sort(chosen.begin(), chosen.end(), [&](auto a, auto b) { return lambda(a) < lambda(b); });
    Eigen::MatrixXd turn = Eigen::MatrixXd::Zero(p + kWidth, whole_panels(wanted_));
    Eigen::VectorXd values(wanted_);
    for (Eigen::Index j = 0; j < wanted_; ++j) {
      const Eigen::Index from = chosen[static_cast<std::size_t>(j)];
      values[j] = lambda(from);
      turn.col(j).head(p) = Y_.col(from);
      turn.col(j).tail(kWidth) = coupling_ * Y_.col(from).tail(kWidth) / theta_[from];
      turn.col(j).normalize();
    }
    rotate(Q_, turn);
    return {std::move(values), std::move(Q_)};
  }

  ShiftInvert& op_;
  Eigen::Index n_;
  Eigen::Index wanted_;
  std::mt19937 random_;
  const std::vector<const Panels*>& deflated_;
  Panels Q_;
  Eigen::MatrixXd T_;
  Small coupling_ = Small::Zero();  // Op Q = Q T + newest * coupling * (last block)^T
  Eigen::Index expected_ = 0, max_steps_ = 0, keep_ = 0;
  Eigen::Index kept_ = 0;  // panels of Ritz vectors after the last restart
  Eigen::VectorXd theta_;
  Eigen::MatrixXd Y_;
  std::vector<Eigen::Index> order_;
};

}  // namespace

int expected_subspace(int count) {
  const double width = static_cast<double>(kWidth);
  const double steps = kDigits / std::acosh(1 + 2 * width / count);
  return static_cast<int>((std::ceil(steps) + std::ceil(count / width) + 1) * width);
}

Result<EigenPairs> nearest_eigenpairs(ShiftInvert& op, int count, std::uint32_t seed,
                                      const std::vector<const Panels*>& deflated) {
  return BlockLanczos(op, count, seed, deflated).run();
}

}  // namespace eigencast
