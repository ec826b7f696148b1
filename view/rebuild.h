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

/// A surface to rebuild: the first vertices of an asset in one pose, the last of them on their way between levels. All
/// that it refers to is kept by others while it is rebuilt.
struct RebuildJob {
  const Asset* asset = nullptr;
  std::shared_ptr<const Reconstructor> basis;  ///< Holds at least the rows of the level.
  std::span<const double> C;                   ///< r x channels, row-major; the first three columns are used.
  std::uint32_t channels = 3;
  std::uint32_t rank = 0;             ///< Of the basis' columns the first so many.
  const LevelMorph* level = nullptr;  ///< N = drawn().
  std::uint32_t first = 0;    ///< Rows before it stand in `geometry` as the last rebuild of this pose left them.
  bool level_changed = true;  ///< Since that rebuild.
  SurfaceGeometry* geometry = nullptr;  ///< To fill; its triangles are those of the level.

  std::uint32_t vertices() const { return level->drawn(); }
};

/// Who rebuilds surfaces: whoever is quicker here, the processor, or the GPU.
enum class RebuildOn { kAuto, kCpu, kGpu };

/// "auto", "cpu", "gpu": as --reconstruct names them.
std::string_view name_of(RebuildOn on);
std::optional<RebuildOn> rebuild_on_from_name(std::string_view name);

/// Fills positions and normals of surfaces from their coefficients: X = Psi C, vertices that come or go between their
/// places (LevelMorph), and of meshes the area-weighted normals of that, of point clouds those of their discs.
class SurfaceRebuilder {
 public:
  /// Time that the caller waited.
  struct Cost {
    TimeUs positions_us = 0, normals_us = 0;
  };

  virtual ~SurfaceRebuilder() = default;
  virtual Cost rebuild(std::span<const RebuildJob> jobs) = 0;
  /// "cpu", "gpu": who does it, for people.
  virtual std::string_view name() const = 0;
};

/// Rebuilds on the processor's threads: surfaces that share a basis, a level and a rank in one pass over that basis.
class CpuRebuilder final : public SurfaceRebuilder {
 public:
  Cost rebuild(std::span<const RebuildJob> jobs) override;
  std::string_view name() const override { return "cpu"; }
};

/// Radii of a point cloud's discs on their way between levels, in geometry's; none where the asset has no discs.
void fill_radii(const Asset& asset, const LevelMorph& level, SurfaceGeometry& geometry);

}  // namespace eigencast
