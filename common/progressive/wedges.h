// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "common/progressive/prefix.h"

namespace eigencast {

using GridUv = std::array<std::uint16_t, 2>;  ///< Texture coordinates on a grid.
using CornerUvs = std::array<GridUv, 3>;      ///< Has one for each corner of a face.

/// UVs of the vertices along a prefix order: the arrays of AssetTexture.
struct WedgeOrder {
  std::vector<std::uint32_t> first_wedge;
  std::vector<GridUv> uvs;
  std::vector<std::uint32_t> parent;
  std::vector<Face> corners;
};

/// Different uvs of one vertex are different wedges. When v goes to u, a wedge of v goes to the one of u with which it
/// shares a face; where there is none u gets one more, at the same UV, so that a side of a seam never goes over to the
/// other. After Hoppe 1999, "New quadric metric for simplifying meshes with appearance attributes".
///   uvs  of the source's faces
WedgeOrder build_wedges(const PrefixOrder& order, std::span<const CornerUvs> uvs);

/// The edges (source numbers, the lower first; ascending) between two faces with different uvs for one of their ends.
std::vector<std::pair<std::uint32_t, std::uint32_t>> seam_edges(std::span<const Face> faces,
                                                                std::span<const CornerUvs> uvs);

}  // namespace eigencast
