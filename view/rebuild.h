// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "common/asset/asset.h"
#include "common/core/clock.h"
#include "common/core/text.h"
#include "common/reconstruction/corner_normals.h"
#include "common/reconstruction/level_morph.h"
#include "common/reconstruction/reconstruct.h"

namespace eigencast {

class GpuSurface;
class Renderer;

/// For each run of LevelTriangles::kBlock values the version of its last change; empty: all are new.
using BlockVersions = std::vector<std::uint64_t>;
/// The values, now `count`, from `first` on change at version `now`.
void mark_from(std::size_t first, std::size_t count, std::uint64_t now, BlockVersions& blocks);
/// Those that differ do.
void mark_different(std::span<const float> before, std::span<const float> values, std::uint64_t now,
                    BlockVersions& blocks);

/// How faces are shaded: as the file's own normals have it, and where it has none by creases; smoothly but along edges
/// that bend by crease_deg or more; all smoothly; each by itself.
enum class Normals { kAuthored, kCrease, kSmooth, kFlat };
inline constexpr int kNormalsKinds = 4;
inline constexpr EnumNames<Normals, kNormalsKinds> kNormalsNames{{"authored", "crease", "smooth", "flat"}};

struct Shading {
  Normals normals = Normals::kAuthored;
  float crease_deg = 40;
  bool operator==(const Shading&) const = default;
};

/// A rebuilt surface to draw. Versions grow when their part changes. Positions and normals are empty where the GPU
/// holds them (make_gpu_rebuilder()).
struct SurfaceGeometry {
  std::uint64_t maker = 0;               ///< The owner of the versions.
  std::vector<float> positions;          ///< N x 3, scene units, in level-of-detail order.
  std::vector<float> normals;            ///< N x 3; empty for a point cloud whose asset brings none.
  std::vector<float> radii;              ///< N, of a point cloud's discs, surface units; may be empty.
  std::vector<std::uint32_t> triangles;  ///< 3 indices each.
  std::uint64_t pose_version = 0;        ///< For positions and normals.
  std::uint64_t level_version = 0;       ///< For radii.
  std::uint64_t topology_version = 0;    ///< For triangles.

  BlockVersions position_blocks, normal_blocks, radius_blocks, triangle_blocks;

  /// Where vertices have several normals; null: nowhere.
  std::shared_ptr<const CornerNormals> corners;
  std::vector<std::uint32_t> corner_triangles;  ///< The triangles, by numbers of normals; empty without `corners`.
  std::vector<float> extra_normals;             ///< Of corners->origins(N); pose_version is theirs, too.
  BlockVersions extra_blocks;
  const std::vector<std::uint32_t>& drawn_triangles() const { return corners ? corner_triangles : triangles; }

  bool is_point_cloud = false;
  bool is_solid = false;    ///< Its faces enclose a volume and look outwards: nothing is seen of their other side.
  float point_spacing = 0;  ///< Typical distance of neighbours at this level, scene units.

  std::shared_ptr<GpuSurface> gpu;  ///< If the GPU has rebuilt it.
  std::uint32_t gpu_vertices = 0;   ///< N of `gpu`.
  std::uint32_t vertex_count() const { return gpu ? gpu_vertices : static_cast<std::uint32_t>(positions.size() / 3); }

  /// Rebuilt positions of the vertices that move between levels: from unmorphed_first to the last.
  std::vector<float> unmorphed;
  std::uint32_t unmorphed_first = 0;
};

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
  SurfaceGeometry* geometry = nullptr;  ///< Filled here; its triangles are those of the level.

  std::uint32_t vertices() const { return level->drawn(); }
};

/// kAuto: where it is faster.
enum class RebuildOn { kAuto, kCpu, kGpu };

/// Named as --reconstruct takes them.
inline constexpr EnumNames<RebuildOn, 3> kRebuildOnNames{{"auto", "cpu", "gpu"}};

/// Fills positions, X = Psi C, and normals (area-weighted, of discs), morphed between levels (LevelMorph).
class SurfaceRebuilder {
 public:
  struct Cost {
    TimeUs positions_us = 0, normals_us = 0;
  };

  virtual ~SurfaceRebuilder() = default;
  virtual Cost rebuild(std::span<const RebuildJob> jobs) = 0;
};

/// Surfaces that share basis, level and rank take one pass over that basis, on the processor's threads.
class CpuRebuilder final : public SurfaceRebuilder {
 public:
  Cost rebuild(std::span<const RebuildJob> jobs) override;
};

/// Sets the geometry's radii of a point cloud's discs, morphed; none if the asset has no discs.
void fill_radii(const Asset& asset, const LevelMorph& level, SurfaceGeometry& geometry);

/// Rebuilds on the GPU with OpenGL 3.3 core: a pose is its coefficients (12 bytes each), positions and normals never
/// leave it. They differ from those of CpuRebuilder by rounding: positions by 2e-6 of the sum of their terms' sizes (of
/// a moving vertex: or of its parents' largest such sum), and by what CpuRebuilder alone rounds coefficients to 16 bits
/// (BasisTiles::whole_coefficients); normals by 0.1 degrees where the surface has any area.
///
/// A surface too large for the GPU's buffers, or with detail (DetailKind), is rebuilt on the processor, without `gpu`.
///
/// The OpenGL context of its creation must be current in every call, and when it and the surfaces that it has rebuilt
/// are destroyed. Not thread-safe. finish: wait for the GPU after each part, so that costs are those of the work.
/// Errors: kUnsupported (OpenGL below 3.3), kInternal (a shader does not compile).
Result<std::unique_ptr<SurfaceRebuilder>> make_gpu_rebuilder(bool finish = false);

struct RebuilderChoice {
  /// Time from coefficients to a drawable pose of the trial surface, the fastest of several; gpu_us is that of an
  /// eighth of the surface where that alone was slower.
  struct Trial {
    TimeUs cpu_us = 0, gpu_us = 0;
    bool gpu_is_faster() const { return gpu_us < cpu_us; }
  };

  std::unique_ptr<SurfaceRebuilder> gpu;  ///< Null: the processor rebuilds.
  std::optional<Trial> trial;             ///< Where it was measured.
};

/// kAuto measures both on a surface of 16,384 vertices and 96 coefficients, which takes a few tens of milliseconds, and
/// falls back to the processor. `renderer` forgets its surfaces. finish: see make_gpu_rebuilder().
/// Errors of kGpu: as make_gpu_rebuilder().
Result<RebuilderChoice> choose_rebuilder(RebuildOn on, Renderer& renderer, bool finish);

}  // namespace eigencast
