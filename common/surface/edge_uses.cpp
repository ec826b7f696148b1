// SPDX-License-Identifier: MIT
#include "common/surface/edge_uses.h"

#include <algorithm>
#include <tuple>

namespace eigencast {

bool has_three_corners(const Face& face, std::size_t n) {
  return face[0] < n && face[1] < n && face[2] < n && face[0] != face[1] && face[1] != face[2] && face[2] != face[0];
}

std::vector<EdgeUse> edge_uses(std::span<const Face> faces, std::size_t vertex_count) {
  std::vector<EdgeUse> uses;
  uses.reserve(3 * faces.size());
  for (std::uint32_t f = 0; f < faces.size(); ++f) {
    if (!has_three_corners(faces[f], vertex_count)) continue;
    for (std::uint32_t side = 0; side < 3; ++side) {
      const std::uint32_t from = faces[f][side], to = faces[f][(side + 1) % 3];
      uses.push_back({std::min(from, to), std::max(from, to), f, static_cast<std::uint8_t>(side), from < to});
    }
  }
  std::sort(uses.begin(), uses.end(), [](const EdgeUse& a, const EdgeUse& b) {
    return std::tie(a.low, a.high, a.face) < std::tie(b.low, b.high, b.face);
  });
  return uses;
}

}  // namespace eigencast
