// SPDX-License-Identifier: MIT
#include "common/spectral/bridges.h"

#include <algorithm>
#include <array>
#include <limits>

#include "common/core/union_find.h"
#include "common/spectral/kd_tree.h"

namespace eigencast {
namespace {

constexpr std::size_t kPairsPerComponent = 3;
constexpr std::size_t kMaxQueries = 4096;

ComponentLabels labels_from(UnionFind& sets) {
  ComponentLabels result;
  result.of_vertex.resize(sets.size());
  for (std::uint32_t i = 0; i < sets.size(); ++i) {
    const std::uint32_t root = sets.root(i);
    result.of_vertex[i] = root == i ? result.count++ : result.of_vertex[root];
  }
  return result;
}

struct VertexPair {
  double squared_distance = std::numeric_limits<double>::infinity();
  std::uint32_t from = 0;
  std::uint32_t to = 0;
};

/// A component's nearest pairs so far, ascending, from distinct vertices where it has enough.
class NearestPairs {
 public:
  explicit NearestPairs(bool distinct) : distinct_(distinct) {}
  double worst() const { return pairs_.back().squared_distance; }
  void add(const VertexPair& pair) {
    if (pair.squared_distance >= worst()) return;
    const auto same = std::find_if(pairs_.begin(), pairs_.end(), [&](const VertexPair& p) {
      return std::isfinite(p.squared_distance) && p.from == pair.from && (distinct_ || p.to == pair.to);
    });
    if (same != pairs_.end()) {
      if (pair.squared_distance >= same->squared_distance) return;
      *same = pair;
    } else {
      pairs_.back() = pair;
    }
    std::stable_sort(pairs_.begin(), pairs_.end(),
                     [](const VertexPair& a, const VertexPair& b) { return a.squared_distance < b.squared_distance; });
  }
  const std::array<VertexPair, kPairsPerComponent>& pairs() const { return pairs_; }

 private:
  bool distinct_;
  std::array<VertexPair, kPairsPerComponent> pairs_{};
};

/// A result set for nanoflann that skips the query vertex's own component.
class OtherComponentSet {
 public:
  using DistanceType = double;
  using IndexType = std::uint32_t;
  OtherComponentSet(const std::vector<std::uint32_t>& labels, std::uint32_t from, NearestPairs& found)
      : labels_(labels), from_(from), found_(found) {}
  std::size_t size() const { return 0; }
  bool empty() const { return false; }
  bool full() const { return true; }
  double worstDist() const { return found_.worst(); }
  bool addPoint(double squared_distance, std::uint32_t to) {
    if (labels_[to] != labels_[from_]) found_.add({squared_distance, from_, to});
    return true;
  }

 private:
  const std::vector<std::uint32_t>& labels_;
  std::uint32_t from_;
  NearestPairs& found_;
};

std::vector<std::vector<std::uint32_t>> members_of(const ComponentLabels& labels) {
  std::vector<std::vector<std::uint32_t>> members(labels.count);
  for (std::uint32_t i = 0; i < labels.of_vertex.size(); ++i) members[labels.of_vertex[i]].push_back(i);
  return members;
}

}  // namespace

ComponentLabels components_from_pattern(const Eigen::SparseMatrix<double>& L) {
  UnionFind sets(static_cast<std::size_t>(L.cols()));
  for (int column = 0; column < L.outerSize(); ++column) {
    for (Eigen::SparseMatrix<double>::InnerIterator it(L, column); it; ++it) {
      sets.join(static_cast<std::uint32_t>(it.row()), static_cast<std::uint32_t>(it.col()));
    }
  }
  return labels_from(sets);
}

std::vector<std::pair<std::uint32_t, std::uint32_t>> find_bridges(std::span<const Vec3> positions,
                                                                  ComponentLabels labels) {
  std::vector<std::pair<std::uint32_t, std::uint32_t>> bridges;
  if (labels.count <= 1) return bridges;
  const PointSet points{positions};
  const KdTree tree(3, points);
  while (labels.count > 1) {
    const auto members = members_of(labels);
    const auto largest = std::max_element(members.begin(), members.end(),
                                          [](const auto& a, const auto& b) { return a.size() < b.size(); });
    UnionFind joined(labels.count);
    for (auto component = members.begin(); component != members.end(); ++component) {
      if (component == largest) continue;
      NearestPairs nearest(component->size() >= kPairsPerComponent);
      const std::size_t stride = (component->size() + kMaxQueries - 1) / kMaxQueries;
      for (std::size_t i = 0; i < component->size(); i += stride) {
        OtherComponentSet found(labels.of_vertex, (*component)[i], nearest);
        tree.findNeighbors(found, positions[(*component)[i]].data(), nanoflann::SearchParams());
      }
      for (const VertexPair& pair : nearest.pairs()) {
        if (!std::isfinite(pair.squared_distance)) continue;
        bridges.emplace_back(std::minmax(pair.from, pair.to));
        joined.join(labels.of_vertex[pair.from], labels.of_vertex[pair.to]);
      }
    }
    const ComponentLabels merged = labels_from(joined);
    for (std::uint32_t& label : labels.of_vertex) label = merged.of_vertex[label];
    labels.count = merged.count;
  }
  // Mutually nearest components find the same pairs.
  std::sort(bridges.begin(), bridges.end());
  bridges.erase(std::unique(bridges.begin(), bridges.end()), bridges.end());
  return bridges;
}

}  // namespace eigencast
