// SPDX-License-Identifier: MIT
#include "common/progressive/wedges.h"

#include <algorithm>
#include <limits>

namespace eigencast {
namespace {

constexpr std::uint32_t kUnknown = std::numeric_limits<std::uint32_t>::max();

/// Undoes the order: contracts its vertices from the last to the base and finds out where their wedges go.
class WedgeContraction {
 public:
  WedgeContraction(const PrefixOrder& order, std::span<const CornerUvs> uvs)
      : order_(order),
        faces_(order.faces),
        wedges_(order.faces.size()),
        around_(order.map.size()),
        uvs_(order.map.size()),
        parents_(order.map.size()) {
    for (std::uint32_t f = 0; f < faces_.size(); ++f) {
      for (std::size_t k = 0; k < 3; ++k) {
        wedges_[f][k] = wedge_at(faces_[f][k], uvs[order.face_source[f]][k]);
        around_[faces_[f][k]].push_back(f);
      }
    }
  }

  WedgeOrder run() {
    WedgeOrder result;
    result.corners = wedges_;
    for (auto v = static_cast<std::uint32_t>(order_.map.size()); v-- > order_.base_count;) contract(v, order_.map[v]);
    result.first_wedge.assign(1, 0);
    for (const auto& mine : uvs_) {
      result.first_wedge.push_back(result.first_wedge.back() + static_cast<std::uint32_t>(mine.size()));
      result.uvs.insert(result.uvs.end(), mine.begin(), mine.end());
    }
    for (std::uint32_t v = 0; v < uvs_.size(); ++v) {
      for (std::uint32_t w = 0; w < uvs_[v].size(); ++w) {
        const bool stays = v < order_.base_count;
        result.parent.push_back(result.first_wedge[stays ? v : order_.map[v]] + (stays ? w : parents_[v][w]));
      }
    }
    for (std::size_t f = 0; f < result.corners.size(); ++f) {
      for (std::size_t k = 0; k < 3; ++k) result.corners[f][k] += result.first_wedge[order_.faces[f][k]];
    }
    return result;
  }

 private:
  std::uint32_t wedge_at(std::uint32_t v, const GridUv& uv) {
    auto& mine = uvs_[v];
    const auto at = static_cast<std::size_t>(std::find(mine.begin(), mine.end(), uv) - mine.begin());
    if (at == mine.size()) mine.push_back(uv);
    return static_cast<std::uint32_t>(at);
  }

  void contract(std::uint32_t v, std::uint32_t u) {
    auto& parents = parents_[v];
    parents.assign(uvs_[v].size(), kUnknown);
    std::vector<bool> seen(parents.size(), false);
    for (const std::uint32_t f : around_[v]) {
      if (order_.death[f] > v) continue;  // gone already
      const std::size_t k = corner_of(f, v), j = corner_of(f, u);
      seen[wedges_[f][k]] = true;
      if (j < 3 && parents[wedges_[f][k]] == kUnknown) parents[wedges_[f][k]] = wedges_[f][j];
    }
    for (std::uint32_t w = 0; w < parents.size(); ++w) {
      // Wedges that no face has any more are invisible and need no UV.
      if (parents[w] == kUnknown) parents[w] = seen[w] || uvs_[u].empty() ? wedge_at(u, uvs_[v][w]) : 0;
    }
    for (const std::uint32_t f : around_[v]) {
      if (order_.death[f] >= v) continue;
      const std::size_t k = corner_of(f, v);
      faces_[f][k] = u;
      wedges_[f][k] = parents[wedges_[f][k]];
      around_[u].push_back(f);
    }
    around_[v] = {};
  }

  std::size_t corner_of(std::uint32_t f, std::uint32_t v) const {
    return static_cast<std::size_t>(std::find(faces_[f].begin(), faces_[f].end(), v) - faces_[f].begin());
  }

  const PrefixOrder& order_;
  std::vector<Face> faces_;   ///< Corners as they are now.
  std::vector<Face> wedges_;  ///< Hold the corners, numbered within their vertex.
  std::vector<std::vector<std::uint32_t>> around_;
  std::vector<std::vector<GridUv>> uvs_;
  std::vector<std::vector<std::uint32_t>> parents_;
};

}  // namespace

WedgeOrder build_wedges(const PrefixOrder& order, std::span<const CornerUvs> uvs) {
  return WedgeContraction(order, uvs).run();
}

std::vector<std::pair<std::uint32_t, std::uint32_t>> seam_edges(std::span<const Face> faces,
                                                                std::span<const CornerUvs> uvs) {
  struct Side {
    std::uint32_t low, high;
    GridUv at_low, at_high;
  };
  std::vector<Side> sides;
  sides.reserve(3 * faces.size());
  for (std::size_t f = 0; f < faces.size(); ++f) {
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t next = (k + 1) % 3;
      const bool rising = faces[f][k] < faces[f][next];
      const std::size_t low = rising ? k : next, high = rising ? next : k;
      sides.push_back({faces[f][low], faces[f][high], uvs[f][low], uvs[f][high]});
    }
  }
  const auto edge_of = [](const Side& side) { return std::pair(side.low, side.high); };
  std::sort(sides.begin(), sides.end(), [&](const Side& a, const Side& b) { return edge_of(a) < edge_of(b); });
  std::vector<std::pair<std::uint32_t, std::uint32_t>> seams;
  for (std::size_t i = 1; i < sides.size(); ++i) {
    const Side &a = sides[i - 1], &b = sides[i];
    if (edge_of(a) != edge_of(b) || (a.at_low == b.at_low && a.at_high == b.at_high)) continue;
    if (seams.empty() || seams.back() != edge_of(a)) seams.push_back(edge_of(a));
  }
  return seams;
}

}  // namespace eigencast
