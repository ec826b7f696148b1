// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <nlohmann/json_fwd.hpp>
#include <span>
#include <vector>

#include "common/asset/asset.h"
#include "common/reconstruction/reconstruct.h"
#include "common/spectral/kg_error.h"
#include "common/surface/checks/edge_difference.h"
#include "common/surface/checks/surface_distance.h"
#include "common/surface/surface.h"

namespace eigencast {

/// Over a set of poses. Fractions are of the rest box's diagonal.
struct SurfaceError {
  std::size_t poses = 0;
  double kg_percent = 0;  ///< KgError, over all poses.
  double rms = 0;         ///< Root mean square of the vertex distances over all poses.
  double mean = 0;        ///< Mean of the same.
  double max = 0;         ///< Largest vertex distance in any pose.
};

nlohmann::json json_from(const SurfaceError& error);

/// Not thread-safe.
class SurfaceErrorSum {
 public:
  /// diagonal  of the rest box, > 0
  explicit SurfaceErrorSum(double diagonal) : diagonal_(diagonal) {}
  /// Returns the pose's own rms, over the diagonal. REQUIRES: as many of both.
  double add(std::span<const Vec3> truth, std::span<const Vec3> rebuilt);
  SurfaceError result() const;

 private:
  double diagonal_;
  KgError kg_;
  double sum_squared_ = 0, sum_ = 0, max_squared_ = 0;
  std::size_t vertices_ = 0, poses_ = 0;
};

/// Positions in the asset's order and space. source: n, in the source's.
std::vector<Vec3> rows_of(const Asset& asset, std::span<const Vec3> source);

/// At full resolution, in the source's vertex order and space. Keeps a reference to the asset. Not thread-safe.
class SourceRebuilder {
 public:
  explicit SourceRebuilder(const Asset& asset);
  /// C: r x channels, row-major. The result stays until the next call.
  std::span<const Vec3> rebuild(std::span<const double> C, std::uint32_t channels);
  /// Likewise, but in the asset's order and space.
  std::vector<Vec3> rebuild_rows(std::span<const double> C, std::uint32_t channels);

 private:
  const Asset& asset_;
  Reconstructor reconstructor_;
  std::vector<float> floats_;
  std::vector<Vec3> positions_;
};

struct LevelError {
  double fraction = 1;  ///< As it was asked for.
  std::uint32_t vertices = 0;
  SurfaceError vertex;  ///< Compares the vertices that the level has.
  double hausdorff =
      0;  ///< Between the level and the truth at full detail, both ways, largest over all poses, over the diagonal.
  EdgeDifferenceError edges;  ///< Compares the level's edges; 0 for point clouds.
};

/// The Hausdorff distance is that of either surface's vertices to the other's triangles (or points), and of points on
/// the level's triangles no farther apart than the edges at full detail. Keeps a reference
/// to the asset. Not thread-safe.
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
