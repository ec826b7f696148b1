// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/asset/asset.h"
#include "common/reconstruction/basis_tiles.h"
#include "view/gl_objects.h"

namespace eigencast {

/// An asset on the GPU, as shaders::kPositions reads it: the tiles of the basis with four columns a texel, and the
/// discs of a point cloud. Needs its context current in every call.
class GpuBasis final {
 public:
  static constexpr std::uint32_t kColumns = 4;  ///< In a texel.

  /// Takes the rows that have arrived since the last call; always call it with the same asset, grown.
  void update(const Asset& asset, const BasisTiles& tiles);

  const GlBuffer& floats() const { return floats_; }
  const GlBuffer& integers() const { return integers_; }
  const GlBuffer& frames() const { return frames_; }              ///< n x 2 integers.
  const GlBuffer& disc_normals() const { return disc_normals_; }  ///< n x 4 floats.
  std::uint32_t float_groups() const { return float_groups_; }
  std::uint32_t integer_groups() const { return integer_groups_; }

  /// The groups of the first `rank` columns, and their coefficients in the shader's order.
  struct Coefficients {
    std::uint32_t float_groups = 0, integer_groups = 0;
    std::vector<float> values;
  };
  static Coefficients pack(const BasisTiles& tiles, std::span<const double> C, std::uint32_t channels,
                           std::uint32_t rank);

  /// Of its largest buffer.
  static std::size_t texels(const Asset& asset);

 private:
  void append_tile(const kernel::Tiles& tile, std::size_t number);
  void append_discs(const Asset& asset);

  GlBuffer floats_, integers_, frames_, disc_normals_;
  std::uint32_t rows_ = 0, discs_ = 0;
  std::uint32_t float_columns_ = 0, float_groups_ = 0, integer_groups_ = 0;
};

}  // namespace eigencast
