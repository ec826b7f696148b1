// SPDX-License-Identifier: MIT
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <type_traits>
#include <vector>

#include "common/asset/tiles/basis_tile.h"
#include "common/asset/tiles/number_coder.h"

namespace eigencast {
namespace {

/// Floats as integers in the same order: neighbours are neighbours, over zero, too.
std::int32_t ordered(float value) {
  const auto bits = std::bit_cast<std::uint32_t>(value);
  return static_cast<std::int32_t>(bits >> 31 != 0 ? 0x7fffffffu - bits : bits);
}
float unordered(std::int32_t number) {
  const auto bits = static_cast<std::uint32_t>(number);
  return std::bit_cast<float>(number < 0 ? 0x7fffffffu - bits : bits);
}

/// The float entries of a tile. The rows that predict a row's integers do so for its floats, weights brought to a sum
/// of one, so that a constant is predicted to the bit. All products and the sums of integers are exact in double: every
/// reader, with or without fused multiplications, finds the same.
class FloatModel {
 public:
  explicit FloatModel(std::size_t rows) : level_(rows, kFirst) {}

  /// Row i of the tile is row `row` of `column`, a column that `stride` floats lie between.
  template <typename Coder>
  float pass(Coder& coder, const Predictors& predictors, std::size_t i, std::size_t row, const float* column,
             std::size_t stride, float value) {
    const float predicted = predict(predictors, i, row, column, stride);
    const int exponent = static_cast<int>(std::bit_cast<std::uint32_t>(predicted) >> 23 & 0xff);
    const int level = std::clamp(level_[i] - exponent, 0, static_cast<int>(contexts_.size()) - 1);
    const auto from = static_cast<std::uint32_t>(ordered(predicted));
    const auto residual = static_cast<std::int32_t>(static_cast<std::uint32_t>(ordered(value)) - from);
    const std::int32_t coded = contexts_[static_cast<std::size_t>(level)].pass(coder, residual);
    level_[i] = exponent + static_cast<int>(std::bit_width(SignedModel::size_of(coded)));
    return unordered(static_cast<std::int32_t>(from + static_cast<std::uint32_t>(coded)));
  }

 private:
  static constexpr int kFirst = 150;

  static float predict(const Predictors& predictors, std::size_t i, std::size_t row, const float* column,
                       std::size_t stride) {
    std::int32_t weights = 0;
    double sum = 0;
    for (std::uint32_t at = predictors.first[i]; at < predictors.first[i + 1]; ++at) {
      weights += predictors.weights[at];
      sum += double{column[predictors.rows[at] * stride]} * predictors.weights[at];
    }
    if (weights <= 0) return row == 0 ? 0 : column[(row - 1) * stride];
    constexpr double kLargest = std::numeric_limits<float>::max();
    return static_cast<float>(std::clamp(sum / weights, -kLargest, kLargest));
  }

  std::vector<int> level_;  // of a row: binary exponent of its last residual
  std::array<SignedModel, 40> contexts_;
};

/// The integer entries of a tile. Rows that are hard to predict are so in every column: the size of a residual is
/// predicted by those that the row has had, times what this column's have been beside that.
class ResidualModel {
 public:
  explicit ResidualModel(std::size_t rows) : of_row_(rows, 2 * kOne) {}

  void next_column() {
    ++columns_;
    met_ = expected_ = kPrior;
  }
  template <typename Coder>
  std::int32_t pass(Coder& coder, std::size_t i, std::int32_t residual) {
    std::int32_t& mean = of_row_[i];
    const std::uint64_t likely = static_cast<std::uint64_t>(mean) * met_ / expected_;
    residual = contexts_[context_of(likely)].pass(coder, residual);
    const auto size = static_cast<std::int32_t>(kOne * std::min(SignedModel::size_of(residual), kMaxCounted));
    met_ += static_cast<std::uint32_t>(size);
    expected_ += static_cast<std::uint32_t>(mean);
    if (expected_ >= kWindow) {
      met_ = (met_ + 1) / 2;
      expected_ = (expected_ + 1) / 2;
    }
    mean = std::max(mean + (size - mean) / std::min(columns_ + 1, kColumnsKept), 1);
    return residual;
  }

 private:
  static constexpr std::int32_t kOne = 16;
  static constexpr std::uint32_t kMaxCounted = 4095;
  static constexpr std::int32_t kColumnsKept = 10;
  static constexpr std::uint32_t kPrior = 1 << 10, kWindow = 1 << 16;

  /// Two to a doubling.
  std::size_t context_of(std::uint64_t likely) const {
    const auto bits = static_cast<std::size_t>(std::bit_width(likely));
    if (bits < 2) return bits;
    return std::min<std::size_t>(2 * bits - 2 + (likely >> (bits - 2) & 1), contexts_.size() - 1);
  }

  std::vector<std::int32_t> of_row_;  // mean size of its residuals, the last ones most
  std::array<SignedModel, 40> contexts_;
  std::int32_t columns_ = 0;
  std::uint32_t met_ = kPrior, expected_ = kPrior;  // in this column: sizes, and what the rows' means are
};

/// Both directions. Values: const floats that are written; floats that are read. `stride` lies between the entries of a
/// column.
template <typename Coder, typename Value>
Result<void> pass_floats(Coder& coder, const BasisBlock& block, std::uint32_t end_column, std::span<Value> values,
                         std::size_t stride) {
  FloatModel model(block.end_row - block.first_row);
  for (std::uint32_t k = block.first_column; k < end_column; ++k) {
    for (std::uint32_t i = block.first_row; i < block.end_row; ++i) {
      auto& entry = values[i * stride + k];
      const float value = model.pass(coder, block.predictors, i - block.first_row, i, &values[k], stride, entry);
      if constexpr (!std::is_const_v<Value>) {
        if (!std::isfinite(value)) return entry_not_finite(i, k);
        entry = value;
      }
    }
  }
  return {};
}

/// Both directions. Values: const floats, rounded and written; integers that are read.
template <typename Coder, typename Value>
Result<void> pass_integers(Coder& coder, const BasisBlock& block, std::uint32_t first_column, std::span<Value> values) {
  constexpr bool kReads = !std::is_const_v<Value>;
  ResidualModel model(block.end_row - block.first_row);
  for (std::uint32_t first = first_column; first < block.end_column; first += IntegerColumns::kMaxColumns) {
    IntegerColumns columns(block, first);
    columns.take(std::span<const Value>(values), 0, kReads ? block.first_row : block.end_row);
    for (std::uint32_t k = first; k < columns.end(); ++k) {
      auto& column = columns[k];
      model.next_column();
      for (std::uint32_t i = block.first_row; i < block.end_row; ++i) {
        const std::int32_t predicted = block.predictors.predict(i - block.first_row, column);
        const std::int32_t residual = model.pass(coder, i - block.first_row, kReads ? 0 : column[i] - predicted);
        if constexpr (kReads) {
          const std::int64_t value = std::int64_t{predicted} + residual;
          if (std::abs(value) > 32767 || (columns.scale(k) == 0 && value != 0)) return entry_out_of_range(i, k);
          column[i] = static_cast<std::int16_t>(value);
        }
      }
    }
    if constexpr (kReads) columns.give(values, block.first_row, block.end_row);
  }
  return {};
}

std::uint32_t first_integer(const BasisBlock& block) {
  return std::clamp(block.exact_columns, block.first_column, block.end_column);
}

}  // namespace

Bytes code_basis(const BasisBlock& block, std::span<const float> basis) {
  Bytes coded;
  BitWriter coder(coded);
  static_cast<void>(pass_floats(coder, block, first_integer(block), basis, block.rank));  // What is written
  static_cast<void>(pass_integers(coder, block, first_integer(block), basis));            // is not checked.
  coder.finish();
  return coded;
}

Result<void> decode_coded_basis(const BasisBlock& block, ByteView coded, const BasisRows& basis) {
  BitReader coder(coded);
  const std::uint32_t end_floats = first_integer(block);
  if (auto read = pass_floats(coder, block, end_floats, basis.floats, block.exact_columns); !read) return read;
  if (auto read = pass_integers(coder, block, end_floats, basis.integers); !read) return read;
  if (!coder.finished()) return fail(ErrorCode::kCorrupt, "basis tile: bytes too many at its end");
  return {};
}

}  // namespace eigencast
