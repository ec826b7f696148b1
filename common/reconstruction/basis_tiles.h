// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/asset/asset.h"
#include "common/reconstruction/kernel.h"
#include "common/reconstruction/lines.h"

namespace eigencast {

/// A pose's coefficients of the integer columns, in the order of kernel::Pose::whole.
struct WholeCoefficients {
  std::vector<std::int16_t> C;
  std::array<float, 3> unit{};
};

/// An asset's basis in tiles for the kernels: its integers and floats as they are. Takes as many bytes as the asset's.
/// Reading is thread-safe.
class BasisTiles {
 public:
  /// Takes the rows of `asset` that have arrived since; at most the first `rows`. Always call it with the same asset.
  void update(const Asset& asset, std::uint32_t rows = ~0U);
  /// Takes memory for the whole asset at once, as AssetReader::reserve().
  void reserve(const Asset& asset);
  /// The same for a matrix of integers: rows() becomes `rows`.
  ///   entries  at least rows x r, row-major; earlier rows unchanged
  ///   scales   r: the unit of each column
  void update(std::span<const std::int16_t> entries, std::span<const float> scales, std::uint32_t rows);

  std::uint32_t rows() const { return rows_; }
  std::uint32_t rank() const { return rank_; }
  std::size_t tile_count() const { return (rows_ + kernel::kTileRows - 1) / kernel::kTileRows; }
  bool has_integers() const { return float_columns_ < rank_; }

  /// The tiles from number `first` on, and of them the first `rank` columns.
  kernel::Tiles view(std::size_t first, std::uint32_t rank) const;
  /// The coefficients of a pose (r x channels, row-major), rounded to 16 bits with one unit per axis: integer products
  /// are twice as fast. Nothing where rounding would add more than a sixteenth to the squared error of the basis' own
  /// grid (3 % of the error), where the first `rank` columns have no integers, or where C is not finite.
  std::optional<WholeCoefficients> whole_coefficients(std::span<const double> C, std::uint32_t channels,
                                                      std::uint32_t rank) const;

  /// The factor of column k's coefficients that undoes the kernels' integer unit.
  double scale(std::uint32_t k) const {
    return k < float_columns_ ? 1 : static_cast<double>(scales_[k - float_columns_]) / kernel::kIntegerUnit;
  }

 private:
  /// Statistics of a column's integers.
  struct Column {
    int largest = 0;
    double squares = 0;
    void add(std::int16_t integer);
  };
  void follow(const Asset& asset);
  void append(const Asset& asset, std::uint32_t end);

  std::uint32_t rows_ = 0, rank_ = 0;
  std::uint32_t float_columns_ = 0;
  std::vector<float> scales_;  // r - float_columns_
  AlignedVector<float> floats_;
  AlignedVector<std::int16_t> integers_;
  std::vector<Column> columns_;  // r - float_columns_
};

/// An asset's detail: derivatives of the basis along two tangents, in tiles, and offsets and normals in the frames that
/// these span. Takes n x r x 4 bytes beside the asset. Reading is thread-safe; update() is not.
class DetailTiles {
 public:
  /// Takes the rows that have arrived since; clears all where the asset's detail has ended.
  void update(const Asset& asset);
  std::uint32_t rows() const { return static_cast<std::uint32_t>(offset_.size()); }
  const BasisTiles& along_x() const { return along_x_; }
  const BasisTiles& along_y() const { return along_y_; }

  /// Adds the detail to the positions of the basis alone, from row `first` on. All have 3 floats a vertex.
  ///   along_x, along_y  the pose's derivatives
  ///   normals           room for as many, or empty
  void add(std::uint32_t first, std::span<const float> along_x, std::span<const float> along_y,
           std::span<float> positions, std::span<float> normals) const;

 private:
  BasisTiles along_x_, along_y_;
  std::vector<std::array<float, 3>> offset_, normal_;
};

}  // namespace eigencast
