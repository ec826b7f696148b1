// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/core/bytes.h"

namespace eigencast {

/// How an image lies on the faces of a surface. A wedge is a UV of a vertex; along seams a vertex has several. Wedges
/// are numbered by vertex, and contract as vertices do: with the first N vertices a corner has the wedge that is found
/// from its own by following `parent` until it is below first_wedge[N], and that is a wedge of the vertex that the
/// corner then has. So both sides of a seam stay apart at every level.
struct AssetTexture {
  static constexpr std::size_t kMaxImageBytes = std::size_t{16} << 20;
  static constexpr std::array<std::uint16_t, 2> kNone{65535, 65535};  ///< A wedge that is not in the image.

  std::vector<std::uint32_t> first_wedge;         ///< n + 1.
  std::vector<std::array<std::uint16_t, 2>> uvs;  ///< W: on a grid of 65535 steps from low to high (65534: high).
  std::array<float, 2> low{0, 0}, high{1, 1};
  std::vector<std::uint32_t> parent;                  ///< W: a wedge of map[i] for those of i >= q; itself below q.
  std::vector<std::array<std::uint32_t, 3>> corners;  ///< F: the wedges of each face's corners.
  Bytes image;                                        ///< A PNG or JPEG file.

  /// In the image: (0, 0) is the upper left corner of its first pixel, (1, 1) the lower right one of its last; beyond
  /// it repeats.
  /// REQUIRES: uvs[wedge] != kNone.
  std::array<float, 2> uv(std::uint32_t wedge) const;
  /// Whether low and high are finite (at most 1e30) and in order.
  bool has_finite_box() const;
};

/// The step of the grid from low to high that is nearest. REQUIRES: low <= value <= high.
std::uint16_t texture_grid(float value, float low, float high);

}  // namespace eigencast
