// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <span>
#include <vector>

#include "common/asset/asset.h"
#include "common/surface/checks/edge_difference.h"
#include "common/surface/checks/surface_distance.h"
#include "sender/surface_error.h"

namespace eigencast {

struct LevelError {
  double fraction = 1;  ///< As it was asked for.
  std::uint32_t vertices = 0;
  SurfaceError vertex;  ///< Of the vertices that the level has.
  double hausdorff =
      0;  ///< Between the level and the truth at full detail, both ways, largest over all poses, over the diagonal.
  EdgeDifferenceError edges;  ///< Of the level's edges; 0 for point clouds.
};

/// The Hausdorff distance is that of either surface's vertices to the other's triangles (or points), and of points on the
/// level's triangles no farther apart than the edges at full detail. Keeps a reference to the asset. Not thread-safe.
class LevelErrorSum {
 public:
  /// REQUIRES: the asset is complete; rest: n rows.
  LevelErrorSum(const Asset& asset, double fraction, std::span<const Vec3> rest);

  /// truth, rebuilt: n rows in the asset's order; `surface` is at the truth.
  void add(std::span<const Vec3> truth, const SurfaceDistance& surface, std::span<const Vec3> rebuilt);
  LevelError result() const;

 private:
  struct Sample {
    Face corners;
    std::array<double, 3> weights;
  };
  void add_samples(std::span<const Vec3> rest);

  const Asset& asset_;
  LevelError level_;
  std::vector<Face> faces_;
  std::vector<std::uint32_t> drawn_at_;  ///< For each row the one that it is drawn at.
  std::vector<Sample> samples_;
  SurfaceErrorSum vertex_;
  EdgeDifference edges_;
  SurfaceDistance drawn_;
  double squared_hausdorff_ = 0;
};

}  // namespace eigencast
