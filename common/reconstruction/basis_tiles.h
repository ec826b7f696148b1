// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <new>
#include <vector>

#include "common/asset/asset.h"
#include "common/reconstruction/kernel.h"

namespace eigencast {

/// Memory that begins at a multiple of a cache line.
template <typename T>
struct CacheLineAllocator {
  using value_type = T;
  CacheLineAllocator() = default;
  template <typename U>
  explicit CacheLineAllocator(const CacheLineAllocator<U>&) {}
  T* allocate(std::size_t count) {
    return static_cast<T*>(::operator new (count * sizeof(T), std::align_val_t{kernel::kAlignment}));
  }
  void deallocate(T* at, std::size_t) { ::operator delete (at, std::align_val_t{kernel::kAlignment}); }
  friend bool operator==(const CacheLineAllocator&, const CacheLineAllocator&) { return true; }
};
template <typename T>
using AlignedVector = std::vector<T, CacheLineAllocator<T>>;

/// An asset's basis as the kernels read it: in tiles, each entry a 16-bit integer where the asset says that the column
/// lies on a grid and every entry does to the bit, else a float. Half the bytes of a basis of floats, and the same
/// basis. Takes n x r x 2 to 4 bytes beside the asset.
///
/// Reading is thread-safe; update() is not.
class BasisTiles {
 public:
  /// Takes the rows of `asset` (this object's first, grown) that have arrived since; at most the first `rows`.
  void update(const Asset& asset, std::uint32_t rows = ~0U);

  std::uint32_t rows() const { return rows_; }
  std::uint32_t rank() const { return rank_; }
  std::size_t tile_count() const { return (rows_ + kernel::kTileRows - 1) / kernel::kTileRows; }
  std::size_t bytes() const { return floats_.size() * sizeof(float) + integers_.size() * sizeof(std::int16_t); }
  bool has_integers() const { return float_columns_ < rank_; }

  /// The tiles from number `first` on, and of them the first `rank` columns.
  kernel::Tiles view(std::size_t first, std::uint32_t rank) const;
  /// What the kernels' entries of column k are to be multiplied by: factor of that column's coefficients.
  double scale(std::uint32_t k) const {
    return k < float_columns_ ? 1 : static_cast<double>(scales_[k - float_columns_]) / kernel::kIntegerUnit;
  }

 private:
  bool append(const Asset& asset, std::uint32_t end);

  std::uint32_t rows_ = 0, rank_ = 0;
  std::uint32_t float_columns_ = 0;
  std::vector<float> scales_;  // r - float_columns_
  AlignedVector<float> floats_;
  AlignedVector<std::int16_t> integers_;
};

}  // namespace eigencast
