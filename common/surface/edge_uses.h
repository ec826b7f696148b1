// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "common/surface/surface.h"

namespace eigencast {

/// One face's part of an edge.
struct EdgeUse {
  std::uint32_t low, high;  ///< Ends of the edge.
  std::uint32_t face;
  std::uint8_t side;  ///< From this corner of the face to the next.
  bool upwards;       ///< The face runs from low to high.
};

bool has_three_corners(const Face& face, std::size_t n);  ///< Three vertices of n.

/// The sides of all faces that have three corners, edge by edge, those of one edge in the order of their faces.
std::vector<EdgeUse> edge_uses(std::span<const Face> faces, std::size_t vertex_count);

/// Calls edge(uses) for the uses of each edge: a span of const EdgeUse, or of EdgeUse where they are given so.
template <class Use, class Edge>
void for_each_edge(std::span<Use> uses, const Edge& edge) {
  for (std::size_t first = 0, last = 0; first < uses.size(); first = last) {
    while (last < uses.size() && uses[last].low == uses[first].low && uses[last].high == uses[first].high) ++last;
    edge(uses.subspan(first, last - first));
  }
}

}  // namespace eigencast
