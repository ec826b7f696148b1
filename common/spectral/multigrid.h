// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/SparseCore>
#include <memory>
#include <vector>

#include "common/core/result.h"
#include "common/spectral/coarsening.h"
#include "common/spectral/shift_invert.h"

namespace eigencast {

/// A surface's operator in symmetric form and coarser ones, 0 the surface's own, each about a seventh of the one before:
///   S  n x n
///   Q  n x n_c, from functions on the next coarser level, in the symmetric form of both; its transpose leads back. None on
///      the coarsest.
/// Borrows the surface's Laplacian.
class Hierarchy {
 public:
  /// Goes on until no more than `enough` vertices are left; never below `least`.
  Hierarchy(const Laplacian& finest, Eigen::Index enough, Eigen::Index least);

  std::size_t depth() const { return levels_.size() - 1; }
  const Laplacian& laplacian(std::size_t level) const { return level == 0 ? finest_ : levels_[level]->laplacian; }
  const Eigen::SparseMatrix<double>& S(std::size_t level) const { return levels_[level]->S; }
  const Eigen::SparseMatrix<double, Eigen::RowMajor>& Q(std::size_t level) const { return levels_[level]->Q; }
  Eigen::Index rows(std::size_t level) const { return S(level).rows(); }

 private:
  struct Level {
    Laplacian laplacian;  // none on the finest
    Eigen::SparseMatrix<double> S;
    Eigen::SparseMatrix<double, Eigen::RowMajor> Q;
  };
  const Laplacian& finest_;
  std::vector<std::unique_ptr<Level>> levels_;
};

/// Z = Q X: a panel of a coarser level on the finer one.
void prolongate(const Eigen::SparseMatrix<double, Eigen::RowMajor>& Q, const double* X, double* Z);

/// An approximate inverse of S where a sparse factor would be too large: half a V-cycle, the correction of the coarser level
/// first, then Chebyshev's iteration scaled by the diagonal, which damps what a coarser level does not see (Adams, Brezina, Hu,
/// Tuminaro 2003, "Parallel multigrid smoothing: polynomial versus Gauss-Seidel"). The first level of few enough vertices is
/// factored. Borrows the hierarchy.
class Multigrid {
 public:
  /// Errors: kNumerical.
  static Result<std::unique_ptr<Multigrid>> create(const Hierarchy& hierarchy, Eigen::Index factored_rows);

  /// The level that is factored, and its factor at first_shift().
  std::size_t factored_level() const { return smoothers_.size(); }
  const ShiftInvert& factor() const { return *coarsest_; }

  /// Working memory of one thread: four panels of the surface and of each coarser level.
  struct Scratch {
    std::vector<Panels> panels;  // residual, correction, its next, step
  };
  Scratch scratch() const;

  /// X <- X - T (S X - X diag(shift)), T this inverse: a step of preconditioned inverse iteration, if shift has the columns'
  /// Ritz values (Knyazev & Neymeyr 2003, "A geometric theory for preconditioned inverse iteration III"). `level` is one that
  /// is not factored. Thread-safe with a scratch for each thread.
  void improve(std::size_t level, double* X, const double* shift, Scratch& scratch) const;

 private:
  struct Smoother {
    Eigen::VectorXd inverse_diagonal;
    double largest = 0;  // eigenvalue of D^{-1} S
  };
  explicit Multigrid(const Hierarchy& hierarchy) : hierarchy_(hierarchy) {}
  double* solve(std::size_t level, Scratch& scratch) const;

  const Hierarchy& hierarchy_;
  std::vector<Smoother> smoothers_;  // of the levels that are not factored
  std::unique_ptr<ShiftInvert> coarsest_;
};

}  // namespace eigencast
