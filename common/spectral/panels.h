// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/Core>
#include <functional>
#include <memory>
#include <vector>

#include "common/spectral/panel_kernel.h"

namespace eigencast {

inline constexpr Eigen::Index kWidth = kPanelWidth;  ///< As Eigen counts.

/// A tall matrix, n x 8 count, in row-major panels of eight columns. All functions use the process's threads; sums do
/// not depend on their number.
class Panels {
 public:
  explicit Panels(Eigen::Index rows) : rows_(rows) {}

  Eigen::Index rows() const { return rows_; }
  Eigen::Index count() const { return static_cast<Eigen::Index>(panels_.size()); }
  Eigen::Index columns() const { return count() * kWidth; }
  double* operator[](Eigen::Index j) { return panels_[static_cast<std::size_t>(j)].get(); }
  const double* operator[](Eigen::Index j) const { return panels_[static_cast<std::size_t>(j)].get(); }

  /// Adds a panel, zero. May throw std::bad_alloc.
  double* append();
  void drop_from(Eigen::Index count) { panels_.resize(static_cast<std::size_t>(count)); }

  double& at(Eigen::Index row, Eigen::Index column) { return (*this)[column / kWidth][row * kWidth + column % kWidth]; }
  double at(Eigen::Index row, Eigen::Index column) const {
    return (*this)[column / kWidth][row * kWidth + column % kWidth];
  }

 private:
  struct Free {
    void operator()(double* at) const;
  };
  Eigen::Index rows_;
  std::vector<std::unique_ptr<double, Free>> panels_;
};

/// Columns of the panels that hold as many.
constexpr Eigen::Index whole_panels(Eigen::Index columns) {
  return (columns + kWidth - 1) / kWidth * kWidth;
}

/// work(j) for each of `count` panels, at the same time.
void for_panels(Eigen::Index count, const std::function<void(Eigen::Index)>& work);

/// `columns` columns, rounded up to whole panels, all zero.
Panels zero_panels(Eigen::Index rows, Eigen::Index columns);
void copy_column(const Panels& from, Eigen::Index i, Panels& to, Eigen::Index j);
/// The columns of X, and zero columns that fill the last panel.
Panels panels_from(const Eigen::MatrixXd& X);
Eigen::MatrixXd matrix_from(const Panels& A, Eigen::Index count);

/// A^T W for the panels [first, end) of A, 8 (end - first) x 8. W is one panel.
Eigen::MatrixXd transposed_product(const Panels& A, Eigen::Index first, Eigen::Index end, const double* W);
/// W -= A H for the same panels of A.
void subtract_product(const Panels& A, Eigen::Index first, Eigen::Index end, const Eigen::MatrixXd& H, double* W);
/// W = W T, T 8 x 8.
void multiply_panel(double* W, Eigen::Index rows, const Eigen::MatrixXd& T);
/// W^T W of one panel.
Eigen::MatrixXd panel_gram(const double* W, Eigen::Index rows);

/// y = x in another order, row by row of a panel: row i of `from` becomes row to_row[i]; or back.
void scatter_rows(const double* from, const int* to_row, Eigen::Index rows, double* to);
void gather_rows(const double* from, const int* from_row, Eigen::Index rows, double* to);

/// A^T A.
Eigen::MatrixXd gram(const Panels& A);
/// A = A T in place; T is A.columns() x any smaller multiple of 8. Panels that are no longer needed are freed.
void rotate(Panels& A, const Eigen::MatrixXd& T);

/// Makes the first m columns of H orthonormal by Cholesky-QR, each a combination of those up to it. Call it twice for
/// columns far from orthonormal. False where they are dependent. REQUIRES: columns beyond m are zero.
bool orthonormalise(Panels& H, Eigen::Index m);

}  // namespace eigencast
