// SPDX-License-Identifier: MIT
#include "view/rebuild.h"

#include <algorithm>
#include <array>
#include <glm/vec2.hpp>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "common/reconstruction/basis_tiles.h"
#include "view/gl_objects.h"
#include "view/gl_surface.h"
#include "view/gpu_shaders.h"

namespace eigencast {
namespace {

constexpr GLsizei kSumsWidth = 1024;  // pixels, one for each vertex
constexpr const char* kVersion = "#version 330 core\n";

constexpr std::size_t kRows = kernel::kTileRows;
constexpr std::size_t kGroup = 4;  // columns in a texel
static_assert(kGroup % 2 == 0, "groups hold whole pairs of columns");

constexpr std::size_t groups_of(std::size_t columns) {
  return (columns + kGroup - 1) / kGroup;
}

std::size_t padded_rows(const Asset& asset) {
  return (asset.vertex_count + kRows - 1) / kRows * kRows;
}

/// A tile's columns, in groups: group, row, column of the group.
template <typename Value, typename Index>
std::vector<Value> in_groups(const Value* columns, std::size_t count, const Index& index_of) {
  std::vector<Value> groups(groups_of(count) * kRows * kGroup);
  for (std::size_t k = 0; k < count; ++k) {
    Value* group = groups.data() + k / kGroup * kRows * kGroup + k % kGroup;
    for (std::size_t row = 0; row < kRows; ++row) group[row * kGroup] = columns[index_of(row, k)];
  }
  return groups;
}

/// An asset on the GPU, as shaders::kPositions reads it: the tiles of the basis with four columns a texel, and the
/// discs of a point cloud. Needs its context current in every call.
class GpuBasis final {
 public:
  /// Takes the rows that have arrived since the last call; always call it with the same asset, grown.
  void update(const Asset& asset, const BasisTiles& tiles) {
    append_discs(asset);
    const auto float_columns = static_cast<std::uint32_t>(tiles.view(0, tiles.rank()).float_columns);
    if (float_columns != float_columns_) rows_ = 0;  // some entry was off the grid: floats hold all
    if (tiles.rows() <= rows_) return;
    float_columns_ = float_columns;
    float_groups_ = static_cast<std::uint32_t>(groups_of(float_columns));
    integer_groups_ = static_cast<std::uint32_t>(groups_of(tiles.rank() - float_columns));
    const std::size_t rows = padded_rows(asset);
    floats_.reserve(rows * float_groups_ * kGroup * sizeof(float), GL_STATIC_DRAW);
    integers_.reserve(rows * integer_groups_ * kGroup * sizeof(std::int16_t), GL_STATIC_DRAW);
    for (std::size_t number = rows_ / kRows; number < tiles.tile_count(); ++number)
      append_tile(tiles.view(number, tiles.rank()), number);
    rows_ = tiles.rows();
  }

  const GlBuffer& floats() const { return floats_; }
  const GlBuffer& integers() const { return integers_; }
  const GlBuffer& frames() const { return frames_; }              ///< n x 2 integers.
  const GlBuffer& disc_normals() const { return disc_normals_; }  ///< n x 4 floats.
  std::uint32_t float_groups() const { return float_groups_; }
  std::uint32_t integer_groups() const { return integer_groups_; }

  /// The groups of the first `rank` columns, and their coefficients in the shader's order.
  struct Coefficients {
    std::uint32_t float_groups = 0, integer_groups = 0;
    std::vector<float> values;
  };

  static Coefficients pack(const BasisTiles& tiles, std::span<const double> C, std::uint32_t channels,
                           std::uint32_t rank) {
    const kernel::Tiles columns = tiles.view(0, rank);
    Coefficients packed;
    packed.float_groups = static_cast<std::uint32_t>(groups_of(columns.float_columns));
    packed.integer_groups = static_cast<std::uint32_t>(groups_of(columns.integer_columns));
    packed.values.resize((packed.float_groups + packed.integer_groups) * std::size_t{3} * kGroup);
    for (std::uint32_t k = 0; k < rank; ++k) {
      const bool integer = k >= columns.float_columns;
      const std::size_t column = integer ? k - columns.float_columns : k;
      const std::size_t group = column / kGroup + (integer ? packed.float_groups : 0);
      const double scale = tiles.scale(k) * (integer ? kernel::kIntegerUnit : 1);
      for (std::size_t d = 0; d < 3; ++d) {
        packed.values[(3 * group + d) * kGroup + column % kGroup] =
            static_cast<float>(C[std::size_t{k} * channels + d] * scale);
      }
    }
    return packed;
  }

  /// Measures its largest buffer.
  static std::size_t texels(const Asset& asset) { return padded_rows(asset) * (groups_of(asset.rank) + 1); }

 private:
  void append_tile(const kernel::Tiles& tile, std::size_t number) {
    const std::vector<float> floats = in_groups(
        tile.floats, tile.float_columns, [](std::size_t row, std::size_t column) { return column * kRows + row; });
    floats_.write(number * floats.size() * sizeof(float), std::span<const float>(floats));
    const std::vector<std::int16_t> integers =
        in_groups(tile.integers, tile.integer_columns, kernel::offset_of_integer);
    integers_.write(number * integers.size() * sizeof(std::int16_t), std::span<const std::int16_t>(integers));
  }

  void append_discs(const Asset& asset) {
    const auto count = static_cast<std::uint32_t>(asset.splats.size());
    if (count <= discs_) return;
    std::vector<std::array<float, 4>> normals;
    for (std::uint32_t i = discs_; i < count; ++i) {
      const auto& n = asset.splats.normal[i];
      normals.push_back({n[0], n[1], n[2], 0});
    }
    constexpr std::size_t kFrameBytes = sizeof(asset.splats.frame[0]), kNormalBytes = sizeof(normals[0]);
    frames_.reserve(asset.vertex_count * kFrameBytes, GL_STATIC_DRAW);
    disc_normals_.reserve(asset.vertex_count * kNormalBytes, GL_STATIC_DRAW);
    frames_.write(discs_ * kFrameBytes, std::span(asset.splats.frame).subspan(discs_));
    disc_normals_.write(discs_ * kNormalBytes, std::span<const std::array<float, 4>>(normals));
    discs_ = count;
  }

  GlBuffer floats_, integers_, frames_, disc_normals_;
  std::uint32_t rows_ = 0, discs_ = 0;
  std::uint32_t float_columns_ = 0, float_groups_ = 0, integer_groups_ = 0;
};

/// A framebuffer that sums over faces: a pixel of three floats for each vertex.
class Sums final : public GlPicture {
 public:
  void reserve(std::uint32_t vertices) {
    const auto rows = static_cast<int>((vertices + kSumsWidth - 1) / kSumsWidth);
    resize(kSumsWidth, std::max(rows, height()), GL_RGBA32F);
  }
  void bind() const {
    glBindFramebuffer(GL_FRAMEBUFFER, framebuffer());
    glViewport(0, 0, kSumsWidth, height());
    glEnable(GL_BLEND);
    glBlendFunc(GL_ONE, GL_ONE);
    glDisable(GL_DEPTH_TEST);
    glDisable(GL_SCISSOR_TEST);
    glEnable(GL_PROGRAM_POINT_SIZE);
  }
  glm::vec2 size() const { return {kSumsWidth, height()}; }
};

/// The longest chain of parents from a moving vertex to one that is not moving.
int generations(const LevelMorph& level, std::span<const std::uint32_t> map) {
  std::vector<int> steps(level.moving().size(), 1);
  int longest = 0;
  for (std::size_t i = 0; i < steps.size(); ++i) {
    const std::uint32_t parent = map[level.whole() + i];
    if (parent >= level.whole()) steps[i] = steps[parent - level.whole()] + 1;
    longest = std::max(longest, steps[i]);
  }
  return longest;
}

class GpuRebuilder final : public SurfaceRebuilder {
 public:
  explicit GpuRebuilder(bool finish) : finish_(finish) {}

  Result<void> init() {
    GLint texels = 0;
    glGetIntegerv(GL_MAX_TEXTURE_BUFFER_SIZE, &texels);
    max_texels_ = static_cast<std::size_t>(texels);
    unused_.reserve(1);
    const std::string version = kVersion, extras = version + shaders::kExtras, level = extras + shaders::kLevel,
                      unit = level + shaders::kUnit;
    struct Source {
      GlProgram& program;
      const char* name;
      std::string vertex, fragment;
      std::vector<const char*> kept;
    };
    const std::array<Source, 6> sources{
        Source{positions_, "positions", shaders::kPositions, "", {"position"}},
        Source{blend_, "levels", level + shaders::kBlendPositions + shaders::kBlend, "", {"position"}},
        Source{face_normals_, "face normals", extras + shaders::kPixel + shaders::kFaceNormals, shaders::kPart, {}},
        Source{share_, "shared normals", level + shaders::kPixel + shaders::kShare, shaders::kPart, {}},
        Source{mesh_normals_, "normals", unit + shaders::kMeshNormals + shaders::kBlend, "", {"normal"}},
        Source{disc_normals_, "disc normals", unit + shaders::kDiscNormals + shaders::kBlend, "", {"normal"}}};
    for (const Source& source : sources) {
      const auto built = source.program.build(source.name, {source.vertex, {}, source.fragment}, source.kept);
      if (!built) return built;
      source.program.use();
      for (const auto& [name, number] :
           {std::pair("floats", kFloats), std::pair("integers", kIntegers), std::pair("C", kC),
            std::pair("positions", kPositions), std::pair("weights", kWeights), std::pair("parents", kParents),
            std::pair("corners", kCorners), std::pair("frames", kFrames), std::pair("rest", kRest),
            std::pair("extras", kExtras)})
        source.program.set(name, static_cast<int>(number));
      source.program.set("sums", static_cast<int>(kSumsUnit));
    }
    return {};
  }

  SurfaceRebuilder::Cost rebuild(std::span<const RebuildJob> jobs) override {
    Cost cost;
    glBindVertexArray(array_.id());
    auto spent = [this, since = steady_now_us()]() mutable {
      if (finish_) glFinish();
      const TimeUs now = steady_now_us();
      return now - std::exchange(since, now);
    };
    for (const RebuildJob& job : jobs) {
      SurfaceGeometry& geometry = *job.geometry;
      if (!fits(*job.asset, geometry)) {
        const Cost here = cpu_.rebuild({&job, 1});
        cost.positions_us += here.positions_us;
        cost.normals_us += here.normals_us;
        spent();
        continue;
      }
      if (!geometry.gpu) geometry.gpu = std::make_shared<GpuSurface>();
      geometry.gpu_vertices = job.vertices();
      read_level(job);
      make_positions(job, *geometry.gpu);
      cost.positions_us += spent();
      geometry.gpu->triangles.follow(geometry);
      if (job.asset->is_point_cloud() && job.level_changed) fill_radii(*job.asset, *job.level, geometry);
      make_normals(job, *geometry.gpu);
      cost.normals_us += spent();
    }
    glDisable(GL_BLEND);
    glBindFramebuffer(GL_FRAMEBUFFER, 0);
    glBindVertexArray(0);
    return cost;
  }

 private:
  struct Basis {
    std::weak_ptr<const Reconstructor> of;
    std::unique_ptr<GpuBasis> gpu;
  };
  enum Unit : GLuint {
    kFloats,
    kIntegers,
    kC,
    kPositions,
    kWeights,
    kParents,
    kCorners,
    kFrames,
    kRest,
    kExtras,
    kUnits
  };
  static constexpr GLuint kSumsUnit = kUnits;

  bool fits(const Asset& asset, const SurfaceGeometry& geometry) const {
    GLint side = 0;
    glGetIntegerv(GL_MAX_TEXTURE_SIZE, &side);
    const std::size_t normals = geometry.corners ? geometry.corners->parents().size() : asset.vertex_count;
    return asset.detail.size() == 0 && GpuBasis::texels(asset) <= max_texels_ &&
           std::size_t{asset.face_total} * 3 <= max_texels_ && normals <= max_texels_ &&
           normals <= static_cast<std::size_t>(side) * kSumsWidth;
  }

  GpuBasis& basis_of(const RebuildJob& job) {
    std::erase_if(bases_, [](const auto& entry) { return entry.second.of.expired(); });
    Basis& basis = bases_[job.basis.get()];
    if (!basis.gpu) basis = {job.basis, std::make_unique<GpuBasis>()};
    basis.gpu->update(*job.asset, job.basis->tiles());
    return *basis.gpu;
  }

  void read(Unit unit, GLenum format, const GlBuffer& buffer) { read(unit, format, buffer.id()); }

  void read(Unit unit, GLenum format, GLuint buffer) {
    bind_texture(unit, GL_TEXTURE_BUFFER, textures_[unit].id());
    glTexBuffer(GL_TEXTURE_BUFFER, format, buffer);
  }

  void read_level(const RebuildJob& job) {
    const std::uint32_t whole = job.level->whole();
    const CornerNormals* corners = job.geometry->corners.get();
    const std::span<const std::uint32_t> map =
        corners != nullptr ? corners->parents() : std::span(std::as_const(job.asset->map));
    weights_.replace(job.level->moving());
    parents_.replace(map.subspan(whole, job.level->moving().size()));
    read(kWeights, GL_R32F, weights_);
    read(kParents, GL_R32I, parents_);
    take_extras(*job.geometry);
    for (const GlProgram* program : {&blend_, &face_normals_, &share_, &mesh_normals_, &disc_normals_}) {
      program->use();
      program->set("whole", static_cast<int>(whole));
      program->set("vertices", static_cast<int>(job.asset->vertex_count));
      program->set("drawn", static_cast<int>(job.vertices()));
    }
  }

  void take_extras(const SurfaceGeometry& geometry) {
    GpuSurface& gpu = *geometry.gpu;
    if (std::exchange(gpu.corners, geometry.corners) != geometry.corners && gpu.corners) {
      std::vector<std::array<std::uint32_t, 2>> extras;
      const std::uint32_t n = gpu.corners->vertices();
      for (const std::uint32_t parent : gpu.corners->parents().subspan(n))
        extras.push_back({gpu.corners->origin(static_cast<std::uint32_t>(n + extras.size())), parent});
      gpu.extras.replace(std::span<const std::array<std::uint32_t, 2>>(extras));
    }
    if (gpu.corners) read(kExtras, GL_RG32I, gpu.extras);
  }

  /// Numbers of the extra normals of the vertices from `first` on.
  struct Extras {
    std::uint32_t first = 0, end = 0;
  };
  static Extras extras_of(const RebuildJob& job, std::uint32_t first) {
    const CornerNormals* corners = job.geometry->corners.get();
    if (corners == nullptr) return {};
    const auto number = [&](std::uint32_t N) {
      return corners->vertices() + static_cast<std::uint32_t>(corners->origins(N).size());
    };
    return {number(first), number(job.vertices())};
  }
  /// Vertices, and normals.
  static std::size_t places(const RebuildJob& job) {
    return job.geometry->corners ? job.geometry->corners->parents().size() : job.asset->vertex_count;
  }

  /// Runs the program for vertices [first, end) and keeps its outputs in the buffer, `bytes` each; draws nothing.
  void keep(const GlBuffer& buffer, GLsizei bytes, std::uint32_t first, std::uint32_t end) {
    if (first >= end) return;
    unused_.bind();
    glBindBufferRange(GL_TRANSFORM_FEEDBACK_BUFFER, 0, buffer.id(), GLintptr{first} * bytes,
                      GLsizeiptr{end - first} * bytes);
    glEnable(GL_RASTERIZER_DISCARD);
    glBeginTransformFeedback(GL_POINTS);
    glDrawArrays(GL_POINTS, static_cast<GLint>(first), static_cast<GLsizei>(end - first));
    glEndTransformFeedback();
    glDisable(GL_RASTERIZER_DISCARD);
    glBindBufferBase(GL_TRANSFORM_FEEDBACK_BUFFER, 0, 0);
  }

  void make_positions(const RebuildJob& job, GpuSurface& gpu) {
    const BasisTiles& tiles = job.basis->tiles();
    const GpuBasis& basis = basis_of(job);
    const GpuBasis::Coefficients packed = GpuBasis::pack(tiles, job.C, job.channels, job.rank);
    coefficients_.replace(std::span<const float>(packed.values));
    read(kFloats, GL_RGBA32F, basis.floats());
    read(kIntegers, GL_RGBA16I, basis.integers());
    read(kC, GL_RGBA32F, coefficients_);
    positions_.use();
    positions_.set("float_groups", static_cast<int>(packed.float_groups));
    positions_.set("integer_groups", static_cast<int>(packed.integer_groups));
    positions_.set("float_stride", static_cast<int>(basis.float_groups()));
    positions_.set("integer_stride", static_cast<int>(basis.integer_groups()));
    gpu.positions.reserve(places(job) * GpuSurface::kPositionBytes, GL_DYNAMIC_COPY);
    keep(gpu.positions, GpuSurface::kPositionBytes, job.first, job.vertices());

    gpu.morphs = !job.level->moving().empty();
    const Extras extras = extras_of(job, 0);
    if (!gpu.morphs && extras.first == extras.end) return;
    read(kPositions, GL_RGBA32F, gpu.positions);
    const std::uint32_t whole = job.level->whole();
    gpu.morphed.reserve(gpu.positions.bytes(), GL_DYNAMIC_COPY);
    blend_.use();
    keep(gpu.morphed, GpuSurface::kPositionBytes, extras.first, extras.end);
    if (!gpu.morphs) return copy_positions(gpu.morphed, gpu.positions, extras.first, extras.end);
    keep(gpu.morphed, GpuSurface::kPositionBytes, whole, job.vertices());
    copy_positions(gpu.positions, gpu.morphed, 0, whole);
  }

  static void copy_positions(const GlBuffer& from, const GlBuffer& to, std::uint32_t first, std::uint32_t end) {
    glBindBuffer(GL_COPY_READ_BUFFER, from.id());
    glBindBuffer(GL_COPY_WRITE_BUFFER, to.id());
    const GLintptr begin = GLintptr{first} * GpuSurface::kPositionBytes;
    glCopyBufferSubData(GL_COPY_READ_BUFFER, GL_COPY_WRITE_BUFFER, begin, begin,
                        GLsizeiptr{end - first} * GpuSurface::kPositionBytes);
  }

  void make_normals(const RebuildJob& job, GpuSurface& gpu) {
    gpu.has_normals = !job.asset->is_point_cloud() || job.asset->splats.size() >= job.vertices();
    if (!gpu.has_normals) return;
    gpu.normals.reserve(places(job) * GpuSurface::kNormalBytes, GL_DYNAMIC_COPY);
    if (job.asset->is_point_cloud()) {
      const GpuBasis& basis = basis_of(job);
      read(kPositions, GL_RGBA32F, gpu.positions);
      read(kFrames, GL_RG32I, basis.frames());
      read(kRest, GL_RGBA32F, basis.disc_normals());
      disc_normals_.use();
    } else {
      const Sums& sums = sum_over_faces(job, gpu);
      bind_texture(kSumsUnit, GL_TEXTURE_2D, sums.texture());
      mesh_normals_.use();
    }
    keep(gpu.normals, GpuSurface::kNormalBytes, 0, job.vertices());
    const Extras extras = extras_of(job, 0);
    keep(gpu.normals, GpuSurface::kNormalBytes, extras.first, extras.end);
  }

  const Sums& sum_over_faces(const RebuildJob& job, GpuSurface& gpu) {
    const std::uint32_t N = job.vertices(), whole = job.level->whole();
    const Extras extras = extras_of(job, whole);
    const std::uint32_t pixels = N + extras_of(job, 0).end - extras_of(job, 0).first;
    sums_.reserve(pixels);
    read(kPositions, GL_RGBA32F, gpu.drawn());
    read(kCorners, GL_R32I, gpu.triangles.buffer());
    sums_.bind();
    glClearBufferfv(GL_COLOR, 0, std::array<float, 4>{}.data());
    face_normals_.use();
    face_normals_.set("size", sums_.size());
    glDrawArrays(GL_POINTS, 0, gpu.triangles.count());
    if (!gpu.morphs) return sums_;
    shared_.reserve(pixels);
    copy_colours(sums_.framebuffer(), shared_.framebuffer(), kSumsWidth, sums_.height());
    shared_.bind();
    share_.use();
    share_.set("size", shared_.size());
    bind_texture(kSumsUnit, GL_TEXTURE_2D, sums_.texture());
    for (const auto& [first, end] : {Extras{whole, N}, extras}) {
      if (first < end)
        glDrawArraysInstanced(GL_POINTS, static_cast<GLint>(first), static_cast<GLsizei>(end - first),
                              generations(*job.level, job.asset->map));
    }
    return shared_;
  }

  bool finish_;
  std::size_t max_texels_ = 0;
  GlArray array_;
  std::array<GlTexture, kUnits> textures_;
  GlProgram positions_, blend_, face_normals_, share_, mesh_normals_, disc_normals_;
  GlBuffer coefficients_, weights_, parents_;
  Sums sums_, shared_;
  Sums unused_;  ///< Bound while nothing is drawn: without a window there is no other framebuffer.
  std::map<const Reconstructor*, Basis> bases_;
  CpuRebuilder cpu_;
};

}  // namespace

Result<std::unique_ptr<SurfaceRebuilder>> make_gpu_rebuilder(bool finish) {
  if (epoxy_gl_version() < 33) return fail(ErrorCode::kUnsupported, "rebuilding surfaces on the GPU takes OpenGL 3.3");
  auto rebuilder = std::make_unique<GpuRebuilder>(finish);
  if (const Result<void> ready = rebuilder->init(); !ready) return ready.error();
  return std::unique_ptr<SurfaceRebuilder>(std::move(rebuilder));
}

}  // namespace eigencast
