// SPDX-License-Identifier: MIT
#include "common/spectral/snapshots.h"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "common/spectral/symmetric_form.h"

namespace eigencast {
namespace {

constexpr double kNoise = 1e-10;  // of the columns' squares: what rounding leaves in a Gram matrix

}  // namespace

Snapshots::Snapshots(std::span<const double> weights, std::size_t most)
    : most_(most), columns_(static_cast<Eigen::Index>(weights.size())) {
  assert(most >= 2 && most % 2 == 0);
  for (const double weight : weights) roots_.push_back(std::sqrt(weight));
}

void Snapshots::add(std::span<const double> field) {
  assert(field.size() == 3 * roots_.size());
  const bool is_kept = is_due();
  ++number_;
  if (!is_kept) return;
  if (is_full()) {
    count_ = most_ / 2;
    stride_ *= 2;
    for (std::size_t column = 3; column < 3 * count_; ++column) {
      const std::size_t from = column / 3 * 6 + column % 3;
      copy_column(columns_, static_cast<Eigen::Index>(from), columns_, static_cast<Eigen::Index>(column));
    }
  }
  const auto first = static_cast<Eigen::Index>(3 * count_++);
  while (columns_.columns() < first + 3) columns_.append();
  for (Eigen::Index i = 0; i < columns_.rows(); ++i) {
    const auto row = static_cast<std::size_t>(i);
    for (Eigen::Index d = 0; d < 3; ++d)
      columns_.at(i, first + d) = roots_[row] * field[3 * row + static_cast<std::size_t>(d)];
  }
}

Eigen::MatrixXd Snapshots::gram() const {
  const auto size = static_cast<Eigen::Index>(3 * count_);
  return eigencast::gram(columns_).topLeftCorner(size, size);
}

Eigen::MatrixXd Snapshots::combined(const Eigen::MatrixXd& T) const {
  assert(T.rows() == static_cast<Eigen::Index>(3 * count_));
  Panels sums = zero_panels(columns_.rows(), T.cols());
  Eigen::MatrixXd negative = Eigen::MatrixXd::Zero(columns_.columns(), sums.columns());
  negative.topLeftCorner(T.rows(), T.cols()) = -T;
  for (Eigen::Index j = 0; j < sums.count(); ++j)
    subtract_product(columns_, 0, columns_.count(), negative.middleCols(j * kWidth, kWidth), sums[j]);
  return matrix_from(sums, T.cols());
}

Components components_of(const Eigen::MatrixXd& gram, Eigen::Index most) {
  const DenseEigen pairs = dense_eigen(gram);
  const Eigen::Index all = pairs.values.size();
  Eigen::Index k = 0;
  while (k < std::min(most, all) && pairs.values[all - 1 - k] > kNoise * std::max(gram.trace(), 0.0)) ++k;
  Components found{pairs.vectors.rightCols(k).rowwise().reverse(), pairs.values.tail(k).reverse()};
  found.T *= found.squares.cwiseSqrt().cwiseInverse().asDiagonal();
  return found;
}

}  // namespace eigencast
