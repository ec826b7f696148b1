// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <nanoflann.hpp>
#include <span>

#include "common/surface/surface.h"

namespace eigencast {

/// A point set for nanoflann; borrows the positions.
struct PointSet {
  std::span<const Vec3> positions;
  std::size_t kdtree_get_point_count() const { return positions.size(); }
  double kdtree_get_pt(std::size_t i, std::size_t axis) const { return positions[i][axis]; }
  template <class Bounds>
  bool kdtree_get_bbox(Bounds&) const {
    return false;
  }
};

using KdTree =
    nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<double, PointSet>, PointSet, 3, std::uint32_t>;

}  // namespace eigencast
