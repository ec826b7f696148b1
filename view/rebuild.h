// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string_view>

#include "common/asset/asset.h"
#include "common/core/clock.h"
#include "common/reconstruction/reconstruct.h"
#include "view/level_morph.h"
#include "view/surface_geometry.h"

namespace eigencast {

/// A surface to rebuild: a level of an asset in one pose. Refers to data that others own.
struct RebuildJob {
  const Asset* asset = nullptr;
  std::shared_ptr<const Reconstructor> basis;  ///< With at least the rows of the level.
  std::span<const double> C;                   ///< r x channels, row-major; the first three columns are used.
  std::uint32_t channels = 3;
  std::uint32_t rank = 0;               ///< Columns of the basis to use.
  const LevelMorph* level = nullptr;    ///< N = drawn().
  std::uint32_t first = 0;              ///< Rows before it are in `geometry` already.
  bool level_changed = true;            ///< Since the last rebuild.
  SurfaceGeometry* geometry = nullptr;  ///< To fill; its triangles are those of the level.

  std::uint32_t vertices() const { return level->drawn(); }
};

/// Where surfaces are rebuilt; kAuto: where it is faster.
enum class RebuildOn { kAuto, kCpu, kGpu };

/// As --reconstruct names them.
std::string_view name_of(RebuildOn on);
std::optional<RebuildOn> rebuild_on_from_name(std::string_view name);

/// Fills positions, X = Psi C, and normals (area-weighted, of discs), morphed between levels (LevelMorph).
class SurfaceRebuilder {
 public:
  /// How long the caller waited.
  struct Cost {
    TimeUs positions_us = 0, normals_us = 0;
  };

  virtual ~SurfaceRebuilder() = default;
  virtual Cost rebuild(std::span<const RebuildJob> jobs) = 0;
  virtual std::string_view name() const = 0;
};

/// Surfaces that share basis, level and rank take one pass over that basis, on the processor's threads.
class CpuRebuilder final : public SurfaceRebuilder {
 public:
  Cost rebuild(std::span<const RebuildJob> jobs) override;
  std::string_view name() const override { return "cpu"; }
};

/// Sets the geometry's radii of a point cloud's discs, morphed; none if the asset has no discs.
void fill_radii(const Asset& asset, const LevelMorph& level, SurfaceGeometry& geometry);

}  // namespace eigencast
