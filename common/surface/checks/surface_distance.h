// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "common/surface/surface.h"
#include "common/surface/vector.h"

namespace eigencast {

/// Distances from points to a surface that moves, or to its points where it has no triangles. Reading is thread-safe.
class SurfaceDistance {
 public:
  /// O(F log F). REQUIRES: at least one position, faces within them.
  SurfaceDistance(std::span<const Vec3> positions, std::span<const Face> faces);

  /// Another pose of the same surface. O(n + F). REQUIRES: as many positions.
  void move_to(std::span<const Vec3> positions);

  /// Squared distance of p to the surface.
  ///   known   a bound from above, squared
  ///   enough  the search ends with what it has as soon as that is not above this, squared
  double squared(const Vec3& p, double known = std::numeric_limits<double>::infinity(), double enough = 0) const;

  /// How far a ray runs to the first triangle beyond `beyond`, in lengths of `along`; infinite: it meets none.
  double way_to(const Vec3& from, const Vec3& along, double beyond) const;

 private:
  struct Node {
    Box box;
    std::uint32_t first =
        0;  ///< A leaf's first entry in order_; an inner node's right child: the left one is the next node.
    std::uint32_t count = 0;  ///< 0: an inner node.
  };
  std::uint32_t build(std::span<std::uint32_t> entries, std::span<const Vec3> centres);
  Box box_of(std::uint32_t entry) const;
  double squared_to(std::uint32_t entry, const Vec3& p) const;

  std::vector<Vec3> positions_;
  std::vector<Face> faces_;
  std::vector<std::uint32_t> order_;  ///< Faces, or points, leaf by leaf.
  std::vector<Node> nodes_;           ///< Children behind their parents.
};

/// The largest squared distance of `points` to a surface: one side of a Hausdorff distance; at least so_far.
///   bounds   of each point's squared distance from above, or empty: they only save time
double farthest_squared(std::span<const Vec3> points, const SurfaceDistance& surface,
                        std::span<const double> bounds = {}, double so_far = 0);

}  // namespace eigencast
