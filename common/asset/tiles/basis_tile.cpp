// SPDX-License-Identifier: MIT
#include "common/asset/tiles/basis_tile.h"

#include <bit>
#include <string>

#include "common/asset/asset_limits.h"

namespace eigencast {
namespace {

Error bad_entry(std::uint32_t row, std::uint32_t column, const char* why) {
  return fail(ErrorCode::kCorrupt,
              "basis tile: row " + std::to_string(row) + " column " + std::to_string(column) + why);
}

}  // namespace

Error entry_not_finite(std::uint32_t row, std::uint32_t column) {
  return bad_entry(row, column, " is not finite");
}
Error entry_out_of_range(std::uint32_t row, std::uint32_t column) {
  return bad_entry(row, column, " is out of its range");
}

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
  const std::uint32_t rows = block.end_row - block.first_row;
  const std::uint32_t first_integer = std::clamp(block.exact_columns, block.first_column, block.end_column);
  const std::size_t floats = std::size_t{rows} * (first_integer - block.first_column);
  const std::size_t integers = std::size_t{rows} * (block.end_column - first_integer);
  Bytes raw(4 * floats + 2 * integers);
  std::size_t at = 0;
  for (std::uint32_t k = block.first_column; k < first_integer; ++k) {
    for (std::uint32_t i = block.first_row; i < block.end_row; ++i, ++at) {
      const auto bits = std::bit_cast<std::uint32_t>(basis[std::size_t{i} * block.rank + k]);
      for (std::size_t plane = 0; plane < 4; ++plane)
        raw[plane * floats + at] = static_cast<std::uint8_t>(bits >> (8 * plane));
    }
  }
  std::uint8_t* low = raw.data() + 4 * floats;
  std::uint8_t* high = low + integers;
  for (std::uint32_t first = first_integer; first < block.end_column; first += IntegerColumns::kMaxColumns) {
    IntegerColumns columns(block, first);
    columns.take(basis, 0, block.end_row);
    for (std::uint32_t k = first; k < columns.end(); ++k) {
      const auto& column = columns[k];
      for (std::uint32_t i = block.first_row; i < block.end_row; ++i) {
        const std::int32_t predicted = block.predictors.predict(i - block.first_row, column);
        const std::uint16_t code = zigzag16(static_cast<std::uint16_t>(column[i] - predicted));
        *low++ = static_cast<std::uint8_t>(code);
        *high++ = static_cast<std::uint8_t>(code >> 8);
      }
    }
  }
  return raw;
}

Result<void> decode_basis(const BasisBlock& block, ByteView raw, const BasisRows& basis) {
  const std::uint32_t rows = block.end_row - block.first_row;
  const std::uint32_t first_integer = std::clamp(block.exact_columns, block.first_column, block.end_column);
  const std::size_t floats = std::size_t{rows} * (first_integer - block.first_column);
  const std::size_t integers = std::size_t{rows} * (block.end_column - first_integer);
  std::size_t at = 0;
  for (std::uint32_t k = block.first_column; k < first_integer; ++k) {
    for (std::uint32_t i = block.first_row; i < block.end_row; ++i, ++at) {
      std::uint32_t bits = 0;
      for (std::size_t plane = 0; plane < 4; ++plane) bits |= std::uint32_t{raw[plane * floats + at]} << (8 * plane);
      const auto value = std::bit_cast<float>(bits);
      if (!std::isfinite(value)) {
        return entry_not_finite(i, k);
      }
      basis.floats[std::size_t{i} * block.exact_columns + k] = value;
    }
  }
  const std::uint8_t* low = raw.data() + 4 * floats;
  const std::uint8_t* high = low + integers;
  for (std::uint32_t first = first_integer; first < block.end_column; first += IntegerColumns::kMaxColumns) {
    IntegerColumns columns(block, first);
    columns.take(basis.integers, 0, block.first_row);
    for (std::uint32_t k = first; k < columns.end(); ++k) {
      auto& column = columns[k];
      for (std::uint32_t i = block.first_row; i < block.end_row; ++i) {
        const std::int32_t predicted = block.predictors.predict(i - block.first_row, column);
        const auto code = static_cast<std::uint16_t>(*low++ | *high++ << 8);
        const auto value = static_cast<std::int16_t>(predicted + unzigzag16(code));
        if (value == -32768 || (columns.scale(k) == 0 && value != 0)) {
          return entry_out_of_range(i, k);
        }
        column[i] = value;
      }
    }
    columns.give(basis.integers, block.first_row, block.end_row);
  }
  return {};
}

}  // namespace eigencast
