// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include "common/asset/tiles/predictor.h"
#include "common/core/bytes.h"
#include "common/core/result.h"

namespace eigencast {

/// The rows and columns of a basis that one tile holds, and what is needed to predict them.
struct BasisBlock {
  std::uint32_t first_row = 0, end_row = 0;
  std::uint32_t first_column = 0, end_column = 0;
  std::uint32_t exact_columns = 0;       ///< Columns of the basis (not of the block) kept as float32.
  std::uint32_t rank = 0;                ///< r
  std::span<const float> column_scales;  ///< r - exact_columns
  const Predictors& predictors;          ///< Predict the block's rows.
};

/// Columns [first, end) of a basis as integers, each row by row to the block's end. Some at a time: a cache line of the
/// basis holds as many entries of a row.
class IntegerColumns {
 public:
  static constexpr std::uint32_t kMaxColumns = 16;
  static constexpr float kLargest = 32767;

  IntegerColumns(const BasisBlock& block, std::uint32_t first)
      : block_(block), first_(first), end_(std::min(first + kMaxColumns, block.end_column)) {
    for (std::uint32_t k = first_; k < end_; ++k) columns_[k - first_].resize(block.end_row);
  }

  std::uint32_t end() const { return end_; }
  std::vector<std::int16_t>& operator[](std::uint32_t k) { return columns_[k - first_]; }
  float scale(std::uint32_t k) const { return block_.column_scales[k - block_.exact_columns]; }

  /// Rounds rows of a basis of floats, n x r.
  void take(std::span<const float> basis, std::uint32_t row, std::uint32_t end_row) {
    for (; row < end_row; ++row) {
      for (std::uint32_t k = first_; k < end_; ++k) {
        (*this)[k][row] = integer_from(basis[std::size_t{row} * block_.rank + k], scale(k));
      }
    }
  }
  /// Copies rows from, and to, a basis of integers, n x (r - exact_columns).
  void take(std::span<const std::int16_t> basis, std::uint32_t row, std::uint32_t end_row) {
    for (; row < end_row; ++row) {
      for (std::uint32_t k = first_; k < end_; ++k) (*this)[k][row] = basis[at(row, k)];
    }
  }
  void give(std::span<std::int16_t> basis, std::uint32_t row, std::uint32_t end_row) {
    for (; row < end_row; ++row) {
      for (std::uint32_t k = first_; k < end_; ++k) basis[at(row, k)] = (*this)[k][row];
    }
  }

  static std::int16_t integer_from(float value, float scale) {
    if (scale == 0) return 0;
    return static_cast<std::int16_t>(std::lrint(std::clamp(value / scale, -kLargest, kLargest)));
  }

 private:
  std::size_t at(std::uint32_t row, std::uint32_t k) const {
    return std::size_t{row} * (block_.rank - block_.exact_columns) + k - block_.exact_columns;
  }

  const BasisBlock& block_;
  std::uint32_t first_, end_;
  std::array<std::vector<std::int16_t>, kMaxColumns> columns_;
};

/// The steps of the inexact columns: those given (one per column of the basis; empty: 0), but at least max |column| /
/// 32767; 0 for a column of zeros.
///   basis  n x r, row-major
std::vector<float> column_scales_from_basis(std::span<const float> basis, std::uint32_t rank,
                                            std::uint32_t exact_columns, std::span<const double> steps);

/// The basis as readers have it: n x r, row-major.
std::vector<float> on_grid(std::span<const float> basis, std::uint32_t rank, std::uint32_t exact_columns,
                           std::span<const float> column_scales);

/// basis: n x r, row-major, not yet quantised.
Bytes encode_basis(const BasisBlock& block, std::span<const float> basis);

/// Where a basis is read into: Asset's arrays, of at least end_row rows.
struct BasisRows {
  std::span<float> floats;
  std::span<std::int16_t> integers;
};

/// Writes rows first_row .. end_row and the block's columns into `basis`, whose earlier rows must hold the same
/// columns. Errors: kCorrupt (a number that is not finite or out of range).
Result<void> decode_basis(const BasisBlock& block, ByteView coded, const BasisRows& basis);

}  // namespace eigencast
