// SPDX-License-Identifier: MIT
#include "common/reconstruction/basis_tiles.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace eigencast {
namespace {

constexpr std::size_t kRows = kernel::kTileRows;

/// The integer that `value` is `scale` times, if there is one of 16 bits.
bool integer_of(float value, float scale, std::int16_t& integer) {
  if (scale == 0) {
    integer = 0;
    return value == 0;
  }
  const float ratio = std::nearbyint(value / scale);
  if (!(std::abs(ratio) <= 32767)) return false;
  integer = static_cast<std::int16_t>(ratio);
  return static_cast<float>(integer) * scale == value;
}

}  // namespace

void BasisTiles::update(const Asset& asset, std::uint32_t rows) {
  if (rank_ == 0) {
    rank_ = asset.rank;
    scales_ = asset.column_scales;
    float_columns_ = scales_.empty() ? rank_ : asset.exact_columns;
  }
  assert(rank_ == asset.rank && float_columns_ + scales_.size() == rank_);
  const std::uint32_t end = std::min(rows, asset.rows_ready);
  if (end <= rows_) return;
  if (append(asset, end)) return;
  // Some entry is off the grid: floats hold it.
  float_columns_ = rank_;
  rows_ = 0;
  scales_.clear();
  floats_.clear();
  integers_ = {};
  append(asset, end);
}

bool BasisTiles::append(const Asset& asset, std::uint32_t end) {
  const std::size_t tiles = (end + kRows - 1) / kRows;
  const std::size_t integer_columns = rank_ - float_columns_;
  floats_.resize(tiles * kRows * float_columns_);
  integers_.resize(tiles * kRows * integer_columns);
  for (std::size_t i = rows_; i < end; ++i) {
    const float* row = &asset.basis[i * rank_];
    float* to = floats_.data() + i / kRows * kRows * float_columns_ + i % kRows;
    for (std::size_t k = 0; k < float_columns_; ++k) to[k * kRows] = row[k];
    std::int16_t* integers =
        integers_.data() + i / kRows * kRows * integer_columns + kernel::place_of_integer(i % kRows);
    for (std::size_t k = 0; k < integer_columns; ++k) {
      if (!integer_of(row[float_columns_ + k], scales_[k], integers[k * kRows])) return false;
    }
  }
  rows_ = end;
  return true;
}

kernel::Tiles BasisTiles::view(std::size_t first, std::uint32_t rank) const {
  assert(rank <= rank_);
  const std::size_t integer_columns = rank_ - float_columns_;
  const std::uint32_t float_columns = std::min(rank, float_columns_);
  return {floats_.data() + first * kRows * float_columns_,
          integers_.data() + first * kRows * integer_columns,
          float_columns,
          float_columns_,
          rank - float_columns,
          integer_columns};
}

}  // namespace eigencast
