// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/Core>
#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <functional>
#include <vector>

#include "common/spectral/panels.h"

namespace eigencast {

/// The order in which a sparse symmetric matrix is eliminated, as Eigen's factorisations take it. Small matrices:
/// approximate minimum degree (Amestoy, Davis, Duff 1996, "An approximate minimum degree ordering algorithm"), which is
/// quick; large ones: nested dissection (Karypis, Kumar 1998, "A fast and high quality multilevel scheme for
/// partitioning irregular graphs"), whose factor of a surface of a million vertices has two thirds of the entries and
/// takes a third of the time. The same matrix gives the same order.
/// METIS handles SIGTERM and SIGABRT while it works (seconds): block SIGTERM in other threads.
class EliminationOrder {
 public:
  using PermutationType = Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int>;
  static constexpr Eigen::Index kLarge = 250'000;  ///< rows from which nested dissection is worth its time

  explicit EliminationOrder(Eigen::Index large = kLarge) : large_(large) {}
  /// S: n x n, both triangles stored. inverse: row inverse[k] of S is eliminated k-th.
  void operator()(const Eigen::SparseMatrix<double>& S, PermutationType& inverse) const;

 private:
  Eigen::Index large_;
};

/// (S - sigma I)^{-1} for a sparse symmetric S by LDL^T, whose pivots also count the eigenvalues below sigma
/// (Sylvester's law of inertia). Eight right-hand sides at a time. Not thread-safe.
class ShiftInvert {
 public:
  /// Borrows S. Orders and analyses it once for all shifts.
  explicit ShiftInvert(const Eigen::SparseMatrix<double>& S);

  /// Factors S - sigma I. False when a pivot breaks down: move sigma a little.
  bool factor(double sigma);
  double sigma() const { return sigma_; }
  /// The number of eigenvalues of S below sigma. REQUIRES: factor() returned true.
  int eigenvalues_below() const { return negative_; }
  Eigen::Index rows() const { return S_.rows(); }

  /// Called after each solve; throws to stop.
  void on_apply(std::function<void()> callback) { callback_ = std::move(callback); }
  /// to = (S - sigma I)^{-1} from, one panel each, or the same one. REQUIRES: factor() returned true.
  void apply(const double* from, double* to);
  /// The same without the callback; thread-safe. scratch: one panel.
  void apply(const double* from, double* to, double* scratch) const;

 private:
  void solve(double* X) const;
  bool solves_well();

  const Eigen::SparseMatrix<double>& S_;
  Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>, Eigen::Lower, EliminationOrder> ldlt_;
  std::function<void()> callback_;
  Eigen::VectorXi order_;         // row i of S is row order_[i] of the factor
  std::vector<double> permuted_;  // a panel in the factor's order
  Eigen::VectorXd inverse_pivots_;
  double norm_ = 0;  // of S, infinity norm
  double sigma_ = 0;
  int negative_ = 0;
};

}  // namespace eigencast
