// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/Core>
#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <cstdint>
#include <functional>

#include "common/core/result.h"

namespace eigencast {

/// (S - sigma I)^{-1} for a sparse symmetric S by LDL^T, whose pivots also count the eigenvalues below sigma
/// (Sylvester's law of inertia). Not thread-safe.
class ShiftInvert {
 public:
  using Scalar = double;

  explicit ShiftInvert(const Eigen::SparseMatrix<double>& S);
  /// Factors S - sigma I on the pattern that was analysed once. False when a pivot breaks down: move sigma a little.
  bool factor(double sigma);
  double sigma() const { return sigma_; }
  /// The number of eigenvalues of S below sigma. REQUIRES: factor() gave true.
  int eigenvalues_below() const { return negative_; }

  /// Subspace that apply() projects out of its result, columns orthonormal; none by default. Borrowed.
  void deflate(const Eigen::MatrixXd* basis) { deflated_ = basis; }
  /// Called after each solve; throws to stop.
  void on_apply(std::function<void()> callback) { callback_ = std::move(callback); }
  void project(Eigen::Ref<Eigen::VectorXd> x) const;

  // What Spectra asks of an operator.
  Eigen::Index rows() const { return S_.rows(); }
  Eigen::Index cols() const { return S_.cols(); }
  void perform_op(const double* x, double* y) const;

 private:
  bool solves_well() const;

  const Eigen::SparseMatrix<double>& S_;
  Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> ldlt_;
  Eigen::VectorXd probe_;
  const Eigen::MatrixXd* deflated_ = nullptr;
  std::function<void()> callback_;
  double norm_ = 0;  // of S, infinity norm
  double sigma_ = 0;
  int negative_ = 0;
};

/// Some eigenpairs of S: column j of `vectors` (orthonormal) goes with values[j]; ascending.
struct EigenPairs {
  Eigen::VectorXd values;
  Eigen::MatrixXd vectors;
};

/// The `count` eigenpairs nearest to the operator's sigma, in the complement of what it deflates. One vector at a time:
/// of an eigenvalue of multiplicity k it may find fewer than k, which the caller learns from inertia. Same seed, same
/// result. REQUIRES: 1 <= count < n. Errors: kNumerical. Lets exceptions of the operator's callback through.
Result<EigenPairs> nearest_eigenpairs(ShiftInvert& op, int count, std::uint32_t seed);

}  // namespace eigencast
