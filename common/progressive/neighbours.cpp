// SPDX-License-Identifier: MIT
#include "common/progressive/neighbours.h"

#include <cassert>
#include <nanoflann.hpp>
#include <utility>

namespace eigencast::progressive {
namespace {

// nanoflann's view of the points; it fixes these names.
struct Points {
  std::span<const Vec3> positions;
  std::vector<std::uint32_t> members;

  std::size_t kdtree_get_point_count() const { return members.size(); }
  double kdtree_get_pt(std::size_t i, std::size_t axis) const { return positions[members[i]][axis]; }
  template <typename BoundingBox>
  bool kdtree_get_bbox(BoundingBox&) const {
    return false;
  }
};

using Index =
    nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<double, Points>, Points, 3, std::uint32_t>;

}  // namespace

struct Neighbours::Tree {
  Tree(std::span<const Vec3> positions, std::vector<std::uint32_t> members)
      : points{positions, std::move(members)}, index(3, points) {
    index.buildIndex();
  }
  Points points;
  Index index;
};

Neighbours::Neighbours(std::span<const Vec3> positions, std::vector<std::uint32_t> members) {
  assert(!members.empty());
  tree_ = std::make_unique<Tree>(positions, std::move(members));
}

Neighbours::~Neighbours() = default;

std::vector<std::uint32_t> Neighbours::nearest(const Vec3& p, std::size_t count) const {
  std::vector<std::uint32_t> found(count);
  std::vector<double> distances(count);
  const std::size_t size = tree_->index.knnSearch(p.data(), count, found.data(), distances.data());
  found.resize(size);
  for (std::uint32_t& i : found) i = tree_->points.members[i];
  return found;
}

}  // namespace eigencast::progressive
