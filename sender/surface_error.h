// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <nlohmann/json_fwd.hpp>
#include <span>
#include <vector>

#include "common/asset/asset.h"
#include "common/reconstruction/reconstruct.h"
#include "common/spectral/kg_error.h"
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

/// At full resolution, in the source's vertex order and space. Keeps a reference to the asset. Not thread-safe.
class SourceRebuilder {
 public:
  explicit SourceRebuilder(const Asset& asset);
  /// C: r x channels, row-major. The result stays until the next call.
  std::span<const Vec3> rebuild(std::span<const double> C, std::uint32_t channels);

 private:
  const Asset& asset_;
  Reconstructor reconstructor_;
  std::vector<float> rows_;
  std::vector<Vec3> positions_;
};

}  // namespace eigencast
