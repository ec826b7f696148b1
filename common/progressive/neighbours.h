// SPDX-License-Identifier: MIT
#pragma once

#include <cassert>
#include <cstdint>
#include <nanoflann.hpp>
#include <span>
#include <utility>
#include <vector>

#include "common/surface/surface.h"

namespace eigencast::progressive {

/// Nearest points among some of a set of points. Thread-safe after construction.
class Neighbours {
 public:
  /// positions must outlive this; `members` are the numbers of those to search. REQUIRES: members is not empty.
  Neighbours(std::span<const Vec3> positions, std::vector<std::uint32_t> members)
      : points_{positions, std::move(members)}, tree_(3, points_) {
    assert(!points_.members.empty());
  }
  Neighbours(const Neighbours&) = delete;  // the tree points to the members

  /// The numbers of the `count` members nearest to p, nearest first (fewer where there are fewer).
  std::vector<std::uint32_t> nearest(const Vec3& p, std::size_t count) const {
    std::vector<std::uint32_t> found(count);
    std::vector<double> distances(count);
    found.resize(tree_.knnSearch(p.data(), count, found.data(), distances.data()));
    for (std::uint32_t& i : found) i = points_.members[i];
    return found;
  }

  const Vec3& position(std::uint32_t number) const { return points_.positions[number]; }

 private:
  struct Points {  // as nanoflann asks
    std::span<const Vec3> positions;
    std::vector<std::uint32_t> members;
    std::size_t kdtree_get_point_count() const { return members.size(); }
    double kdtree_get_pt(std::size_t i, std::size_t axis) const { return positions[members[i]][axis]; }
    bool kdtree_get_bbox(auto&) const { return false; }
  };

  Points points_;
  nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<double, Points>, Points, 3, std::uint32_t> tree_;
};

}  // namespace eigencast::progressive
