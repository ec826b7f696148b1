// SPDX-License-Identifier: MIT
#include "common/spectral/multigrid.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <utility>

#include "common/spectral/symmetric_form.h"

namespace eigencast {
namespace {

constexpr Eigen::Index kWidth = kPanelWidth;
constexpr double kSmoothedShare =
    10;                     // eigenvalues down to a tenth of the largest are damped: an aggregate has seven vertices
constexpr int kDegree = 4;  // of Chebyshev's polynomial: what is damped shrinks to a seventh at least

using RowMatrix = Eigen::SparseMatrix<double, Eigen::RowMajor>;

/// No eigenvalue of D^{-1} S is larger: Gershgorin's circles, and on the surface itself those of single triangles, of which S
/// is the sum (Wathen 1987, "Realistic eigenvalue bounds for the Galerkin mass matrix"): three that add up to 3, one of them 0.
double largest_eigenvalue(const Eigen::SparseMatrix<double>& S, bool of_triangles) {
  double largest = 0;
  for (int row = 0; row < S.outerSize(); ++row) {
    double sum = 0, diagonal = 0;
    for (Eigen::SparseMatrix<double>::InnerIterator it(S, row); it; ++it) {
      sum += std::abs(it.value());
      if (it.row() == row) diagonal = it.value();
    }
    if (diagonal > 0) largest = std::max(largest, sum / diagonal);
  }
  return of_triangles ? std::min(largest, 3.0) : largest;
}

/// Rows of Q X added to Z.
void add_prolongated(const RowMatrix& Q, const double* X, double* Z) {
  for (Eigen::Index i = 0; i < Q.outerSize(); ++i) {
    double* row = Z + i * kWidth;
    for (RowMatrix::InnerIterator it(Q, i); it; ++it) {
      const double* other = X + it.col() * kWidth;
      for (Eigen::Index k = 0; k < kWidth; ++k) row[k] += it.value() * other[k];
    }
  }
}

/// Y = Q^T X.
void restrict_to_coarser(const RowMatrix& Q, const double* X, double* Y) {
  std::fill_n(Y, Q.cols() * kWidth, 0.0);
  for (Eigen::Index i = 0; i < Q.outerSize(); ++i) {
    const double* row = X + i * kWidth;
    for (RowMatrix::InnerIterator it(Q, i); it; ++it) {
      double* other = Y + it.col() * kWidth;
      for (Eigen::Index k = 0; k < kWidth; ++k) other[k] += it.value() * row[k];
    }
  }
}

}  // namespace

Hierarchy::Hierarchy(const Laplacian& finest, Eigen::Index enough, Eigen::Index least) : finest_(finest) {
  levels_.push_back(std::make_unique<Level>());
  levels_.back()->S = symmetric_form(finest);
  while (rows(depth()) > enough) {
    const Laplacian& fine = laplacian(depth());
    Coarsened coarse = coarsen(fine);
    const Eigen::Index now = coarse.laplacian.L.rows();
    if (now < least || 10 * now > 9 * rows(depth())) break;
    levels_.back()->Q =
        fine.mass.cwiseSqrt().asDiagonal() * coarse.P * coarse.laplacian.mass.cwiseSqrt().cwiseInverse().asDiagonal();
    levels_.push_back(std::make_unique<Level>());
    levels_.back()->S = symmetric_form(coarse.laplacian);
    levels_.back()->laplacian = std::move(coarse.laplacian);
  }
}

void prolongate(const RowMatrix& Q, const double* X, double* Z) {
  std::fill_n(Z, Q.rows() * kWidth, 0.0);
  add_prolongated(Q, X, Z);
}

Result<std::unique_ptr<Multigrid>> Multigrid::create(const Hierarchy& hierarchy, Eigen::Index factored_rows) {
  std::unique_ptr<Multigrid> grid(new Multigrid(hierarchy));
  std::size_t level = 0;
  for (; level < hierarchy.depth() && hierarchy.rows(level) > factored_rows; ++level) {
    Smoother smoother;
    smoother.inverse_diagonal = hierarchy.S(level).diagonal().unaryExpr([](double d) { return d > 0 ? 1 / d : 0.0; });
    smoother.largest = largest_eigenvalue(hierarchy.S(level), level == 0);
    grid->smoothers_.push_back(std::move(smoother));
  }
  grid->coarsest_ = std::make_unique<ShiftInvert>(hierarchy.S(level));
  if (grid->coarsest_->factor(first_shift(hierarchy.laplacian(level).area))) return grid;
  return cannot_be_factored();
}

Multigrid::Scratch Multigrid::scratch() const {
  Scratch scratch;
  for (std::size_t level = 0; level < smoothers_.size(); ++level) {
    scratch.panels.push_back(zero_panels(hierarchy_.rows(level), 4 * kWidth));
  }
  scratch.panels.push_back(zero_panels(coarsest_->rows(), 2 * kWidth));
  return scratch;
}

/// The residual is in panel 0 of the level; returns where the correction is.
double* Multigrid::solve(std::size_t level, Scratch& scratch) const {
  Panels& here = scratch.panels[level];
  if (level == smoothers_.size()) {
    coarsest_->apply_in_place(here[0], here[1]);
    return here[0];
  }
  restrict_to_coarser(hierarchy_.Q(level), here[0], scratch.panels[level + 1][0]);
  double *Z = here[1], *next = here[2];
  prolongate(hierarchy_.Q(level), solve(level + 1, scratch), Z);

  const Smoother& smoother = smoothers_[level];
  const double low = smoother.largest / kSmoothedShare;
  const double middle = (smoother.largest + low) / 2, half = (smoother.largest - low) / 2;
  double ratio = half / middle;
  ChebyshevStep step{smoother.inverse_diagonal.data(), 0, 1 / middle};
  for (int k = 0; k < kDegree; ++k) {
    panel_functions().smooth(rows_of(hierarchy_.S(level)), step, 0, static_cast<std::size_t>(here.rows()), here[0], Z,
                             here[3], next);
    std::swap(Z, next);
    const double after = 1 / (2 * middle / half - ratio);
    step.keep = after * ratio;
    step.step = 2 * after / half;
    ratio = after;
  }
  return Z;
}

void Multigrid::improve(std::size_t level, double* X, const double* shift, Scratch& scratch) const {
  assert(level < smoothers_.size());
  Panels& here = scratch.panels[level];
  panel_functions().multiply(rows_of(hierarchy_.S(level)), 0, static_cast<std::size_t>(here.rows()), X, shift, here[0]);
  const double* Z = solve(level, scratch);
  for (Eigen::Index i = 0; i < here.rows() * kWidth; ++i) X[i] -= Z[i];
}

}  // namespace eigencast
