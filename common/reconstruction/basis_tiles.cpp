// SPDX-License-Identifier: MIT
#include "common/reconstruction/basis_tiles.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstdlib>

#include "common/asset/detail.h"

namespace eigencast {
namespace {

constexpr std::size_t kRows = kernel::kTileRows;
constexpr double kLargestWhole = 32767;
constexpr double kLargestSum = 2.0e9;       // below 2^31 with the rounding of 4,096 coefficients
constexpr double kRoundingShare = 1.0 / 4;  // of the error of the basis; adds 3 % to it

}  // namespace

inline void BasisTiles::Column::add(std::int16_t integer) {
  largest = std::max(largest, std::abs(int{integer}));
  squares += static_cast<double>(integer) * integer;
}

void BasisTiles::follow(const Asset& asset) {
  if (rank_ == 0) {
    rank_ = asset.rank;
    scales_ = asset.column_scales;
    float_columns_ = asset.float_columns();
  }
  assert(rank_ == asset.rank && float_columns_ + scales_.size() == rank_);
}

void BasisTiles::reserve(const Asset& asset) {
  follow(asset);
  const std::size_t rows = (asset.vertex_count + kRows - 1) / kRows * kRows;
  floats_.reserve(rows * float_columns_);
  integers_.reserve(rows * kernel::whole_pairs(rank_ - float_columns_));
}

void BasisTiles::update(const Asset& asset, std::uint32_t rows) {
  follow(asset);
  const std::uint32_t end = std::min(rows, asset.rows_ready);
  if (end > rows_) append(asset, end);
}

void BasisTiles::append(const Asset& asset, std::uint32_t end) {
  const std::size_t tiles = (end + kRows - 1) / kRows;
  const std::size_t integer_columns = rank_ - float_columns_, stride = kernel::whole_pairs(integer_columns);
  floats_.resize(tiles * kRows * float_columns_);
  integers_.resize(tiles * kRows * stride);
  columns_.resize(integer_columns);
  for (std::size_t i = rows_; i < end; ++i) {
    const float* row = asset.floats.data() + i * float_columns_;
    float* to = floats_.data() + i / kRows * kRows * float_columns_ + i % kRows;
    for (std::size_t k = 0; k < float_columns_; ++k) to[k * kRows] = row[k];
    const std::int16_t* entries = asset.integers.data() + i * integer_columns;
    std::int16_t* integers = integers_.data() + i / kRows * kRows * stride;
    for (std::size_t k = 0; k < integer_columns; ++k) {
      integers[kernel::offset_of_integer(i % kRows, k)] = entries[k];
      columns_[k].add(entries[k]);
    }
  }
  rows_ = end;
}

void BasisTiles::update(std::span<const std::int16_t> entries, std::span<const float> scales, std::uint32_t rows) {
  if (rank_ == 0) {
    rank_ = static_cast<std::uint32_t>(scales.size());
    scales_.assign(scales.begin(), scales.end());
  }
  assert(float_columns_ == 0 && rank_ == scales.size() && entries.size() >= std::size_t{rows} * rank_);
  const std::size_t stride = kernel::whole_pairs(rank_);
  integers_.resize((rows + kRows - 1) / kRows * kRows * stride);
  columns_.resize(rank_);
  for (std::size_t i = rows_; i < rows; ++i) {
    std::int16_t* integers = integers_.data() + i / kRows * kRows * stride;
    for (std::size_t k = 0; k < rank_; ++k) {
      const std::int16_t entry = entries[i * rank_ + k];
      integers[kernel::offset_of_integer(i % kRows, k)] = entry;
      columns_[k].add(entry);
    }
  }
  rows_ = std::max(rows_, rows);
}

kernel::Tiles BasisTiles::view(std::size_t first, std::uint32_t rank) const {
  assert(rank <= rank_);
  const std::size_t stride = kernel::whole_pairs(rank_ - float_columns_);
  const std::uint32_t float_columns = std::min(rank, float_columns_);
  return {floats_.data() + first * kRows * float_columns_,
          integers_.data() + first * kRows * stride,
          float_columns,
          float_columns_,
          kernel::whole_pairs(rank - float_columns),
          stride};
}

std::optional<WholeCoefficients> BasisTiles::whole_coefficients(std::span<const double> C, std::uint32_t channels,
                                                                std::uint32_t rank) const {
  assert(rank <= rank_);
  if (rank <= float_columns_) return std::nullopt;
  const std::size_t columns = rank - float_columns_;
  const auto steps = [&](std::size_t k, std::size_t d) {  // what one unit of the column's integers moves a vertex by
    return C[(float_columns_ + k) * channels + d] * static_cast<double>(scales_[k]);
  };
  WholeCoefficients whole;
  double squares = 0;  // of the integers in a row, in the mean
  for (std::size_t k = 0; k < columns; ++k) squares += columns_[k].squares / rows_;
  double of_basis = 0, of_rounding = 0;
  for (std::size_t d = 0; d < 3; ++d) {
    double most = 0, sum = 0;
    for (std::size_t k = 0; k < columns; ++k) {
      const double step = std::abs(steps(k, d));
      most = std::max(most, step);
      sum += step * columns_[k].largest;
      of_basis += step * step;
    }
    const double unit = std::max(most / kLargestWhole, sum / kLargestSum);
    of_rounding += unit * unit * squares;
    whole.unit[d] = static_cast<float>(unit);
  }
  if (!std::isfinite(of_basis) || of_rounding > kRoundingShare * kRoundingShare * of_basis) return std::nullopt;
  whole.C.resize(3 * kernel::whole_pairs(columns));
  for (std::size_t k = 0; k < columns; ++k) {
    for (std::size_t d = 0; d < 3; ++d) {
      const double unit = whole.unit[d];
      if (!(unit > 0)) continue;
      const double rounded = std::nearbyint(steps(k, d) / unit);
      whole.C[3 * (k - k % 2) + 2 * d + k % 2] =
          static_cast<std::int16_t>(std::clamp(rounded, -kLargestWhole, kLargestWhole));
    }
  }
  return whole;
}

void DetailTiles::update(const Asset& asset) {
  const Asset::Detail& detail = asset.detail;
  if (detail.size() < asset.rows_ready || detail.size() == 0) {
    *this = {};
    return;
  }
  along_x_.update(detail.along_x, detail.steps, asset.rows_ready);
  along_y_.update(detail.along_y, detail.steps, asset.rows_ready);
  const auto known = static_cast<std::ptrdiff_t>(offset_.size());
  offset_.insert(offset_.end(), detail.offset.begin() + known, detail.offset.begin() + asset.rows_ready);
  normal_.insert(normal_.end(), detail.normal.begin() + known, detail.normal.begin() + asset.rows_ready);
}

void DetailTiles::add(std::uint32_t first, std::span<const float> along_x, std::span<const float> along_y,
                      std::span<float> positions, std::span<float> normals) const {
  using Vector = std::array<float, 3>;
  const auto vector_at = [](std::span<const float> values, std::size_t i) {
    return Vector{values[i], values[i + 1], values[i + 2]};
  };
  assert(along_x.size() == along_y.size() && positions.size() >= along_x.size());
  for (std::size_t i = 0; i < along_x.size(); i += 3) {
    const std::size_t row = first + i / 3;
    const auto frame = frame_from_derivatives(vector_at(along_x, i), vector_at(along_y, i));
    const Vector offset = frame.from_frame(offset_[row]);
    for (std::size_t d = 0; d < 3; ++d) positions[i + d] += offset[d];
    if (normals.empty()) continue;
    const Vector normal = frame.from_frame(normal_[row]);
    std::copy(normal.begin(), normal.end(), normals.begin() + static_cast<std::ptrdiff_t>(i));
  }
}

}  // namespace eigencast
