// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/asset/asset.h"
#include "common/reconstruction/basis_tiles.h"

namespace eigencast {

/// An asset's detail: derivatives of the basis along two tangents, in tiles, and offsets and normals in the frames that
/// these span. Takes n x r x 4 bytes beside the asset. Reading is thread-safe; update() is not.
class DetailTiles {
 public:
  /// Takes the rows that have arrived since; clears all where the asset's detail has ended.
  void update(const Asset& asset);
  std::uint32_t rows() const { return static_cast<std::uint32_t>(offset_.size()); }
  const BasisTiles& along_x() const { return along_x_; }
  const BasisTiles& along_y() const { return along_y_; }

  /// Adds the detail to vertices rebuilt from the basis.
  ///   first             row of the first vertex
  ///   along_x, along_y  the pose's derivatives, 3 floats each
  ///   positions         likewise; in: of the basis alone
  ///   normals           room for as many, or empty
  void add(std::uint32_t first, std::span<const float> along_x, std::span<const float> along_y,
           std::span<float> positions, std::span<float> normals) const;

 private:
  BasisTiles along_x_, along_y_;
  std::vector<std::array<float, 3>> offset_, normal_;
};

}  // namespace eigencast
