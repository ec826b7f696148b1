// SPDX-License-Identifier: MIT
#include "common/asset/tiles/basis_tile.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <string>
#include <type_traits>
#include <vector>

#include "common/asset/asset_limits.h"
#include "common/asset/tiles/number_coder.h"

namespace eigencast {
namespace {

Error bad_entry(std::uint32_t row, std::uint32_t column, const char* why) {
  return fail(ErrorCode::kCorrupt,
              "basis tile: row " + std::to_string(row) + " column " + std::to_string(column) + why);
}

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
        if (!std::isfinite(value)) return bad_entry(i, k, " is not finite");
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
          if (std::abs(value) > 32767 || (columns.scale(k) == 0 && value != 0))
            return bad_entry(i, k, " is out of its range");
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

std::vector<float> column_scales_from_basis(std::span<const float> basis, std::uint32_t rank,
                                            std::uint32_t exact_columns, std::span<const double> steps) {
  std::vector<float> scales(rank - exact_columns, 0.0F);
  for (std::size_t row = 0; row < basis.size(); row += rank) {
    for (std::uint32_t k = exact_columns; k < rank; ++k) {
      scales[k - exact_columns] = std::max(scales[k - exact_columns], std::abs(basis[row + k]));
    }
  }
  for (std::size_t k = 0; k < scales.size(); ++k) {
    scales[k] /= IntegerColumns::kLargest;
    if (scales[k] < asset_limits::kMinColumnScale) {
      scales[k] = 0;
    } else if (!steps.empty()) {
      scales[k] = std::max(
          scales[k], static_cast<float>(std::min(steps[exact_columns + k], double{asset_limits::kMaxColumnScale})));
    }
  }
  return scales;
}

std::vector<float> on_grid(std::span<const float> basis, std::uint32_t rank, std::uint32_t exact_columns,
                           std::span<const float> column_scales) {
  std::vector<float> rounded(basis.begin(), basis.end());
  for (std::size_t row = 0; row < rounded.size(); row += rank) {
    for (std::uint32_t k = exact_columns; k < rank; ++k) {
      const float scale = column_scales[k - exact_columns];
      rounded[row + k] = static_cast<float>(IntegerColumns::integer_from(rounded[row + k], scale)) * scale;
    }
  }
  return rounded;
}

Bytes encode_basis(const BasisBlock& block, std::span<const float> basis) {
  Bytes coded;
  BitWriter coder(coded);
  static_cast<void>(pass_floats(coder, block, first_integer(block), basis, block.rank));  // What is written
  static_cast<void>(pass_integers(coder, block, first_integer(block), basis));            // is not checked.
  coder.finish();
  return coded;
}

Result<void> decode_basis(const BasisBlock& block, ByteView coded, const BasisRows& basis) {
  BitReader coder(coded);
  const std::uint32_t end_floats = first_integer(block);
  if (auto read = pass_floats(coder, block, end_floats, basis.floats, block.exact_columns); !read) return read;
  if (auto read = pass_integers(coder, block, end_floats, basis.integers); !read) return read;
  if (!coder.finished()) return fail(ErrorCode::kCorrupt, "basis tile: bytes too many at its end");
  return {};
}

}  // namespace eigencast
