// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/asset/asset.h"

namespace eigencast {

/// How rows of a basis are predicted from rows before them, the same in every integer column:
///   v[i] is near (sum_j weight_j v[row_j] + 32) >> 6.
/// Rows follow each other from the first on; predictor j of the i-th of them is at first[i] + j.
struct Predictors {
  static constexpr std::size_t kMaxPerRow = 8;     ///< One row has no more.
  static constexpr std::int32_t kMaxWeight = 511;  ///< In magnitude, so that sums fit 32 bits.
  static constexpr int kOneBits = 6;               ///< 64 means one.

  std::vector<std::uint32_t> first{0};  ///< One more than rows.
  std::vector<std::uint32_t> rows;      ///< Each before the row it predicts.
  std::vector<std::int16_t> weights;

  std::size_t row_count() const { return first.size() - 1; }
  void end_row() { first.push_back(static_cast<std::uint32_t>(rows.size())); }

  /// For the i-th row here. column: the values of all rows before it.
  std::int32_t predict(std::size_t i, std::span<const std::int16_t> column) const {
    std::int32_t sum = 1 << (kOneBits - 1);
    for (std::uint32_t at = first[i]; at < first[i + 1]; ++at) sum += std::int32_t{weights[at]} * column[rows[at]];
    return sum >> kOneBits;
  }
};

/// Predicts by least squares over the integer columns, among rows that are near in the order of contraction: those that
/// predict a row's parent, its siblings and theirs. Costs on the order of n * 10^4 operations.
///   column_scales  of the columns from exact_columns on, as in the manifest
Predictors choose_predictors(const Asset& asset, std::uint32_t exact_columns, std::span<const float> column_scales);

Predictors part_of(const Predictors& all, std::uint32_t begin, std::uint32_t end);

}  // namespace eigencast
