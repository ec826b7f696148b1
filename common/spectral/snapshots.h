// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "common/spectral/panels.h"

namespace eigencast {

/// Fields on the vertices of a surface, one for each pose, kept for their principal components: at most so many, evenly
/// spaced over all that came. Where there is no room for more, every second one goes, and from then on every second one
/// comes. Holds 24 n bytes each. Not thread-safe.
class Snapshots {
 public:
  /// weights: n, above 0: of the inner product.  most: even, at least 2.
  Snapshots(std::span<const double> weights, std::size_t most);

  /// Whether the next field is to be kept: add() ignores others.
  bool is_due() const { return number_ % stride_ == 0; }
  /// Whether keeping it makes every second one go.
  bool is_full() const { return count_ == most_; }
  /// field: n x 3, row-major. May throw std::bad_alloc.
  void add(std::span<const double> field);
  std::size_t count() const { return count_; }
  std::size_t stride() const { return stride_; }  ///< Snapshot s is the field of number s stride().

  /// Inner products of the snapshots' columns, which are 3 s, 3 s + 1 and 3 s + 2.
  Eigen::MatrixXd gram() const;
  /// n x k: combinations of those columns, times the roots of the weights.
  ///   T  3 count() x k
  Eigen::MatrixXd combined(const Eigen::MatrixXd& T) const;

 private:
  std::vector<double> roots_;
  std::size_t most_, count_ = 0, stride_ = 1, number_ = 0;
  Panels columns_;  ///< Times the roots of the weights.
};

/// Orthonormal combinations of columns that capture most of them; of their Gram matrix (Sirovich 1987, "Turbulence and
/// the dynamics of coherent structures").
struct Components {
  Eigen::MatrixXd T;        ///< Columns x k, T^T gram T = I.
  Eigen::VectorXd squares;  ///< k, descending: the sums of squares of the columns' coefficients.
};

/// The first `most`, fewer where the columns have less rank.
Components components_of(const Eigen::MatrixXd& gram, Eigen::Index most);

}  // namespace eigencast
