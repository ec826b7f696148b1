// SPDX-License-Identifier: MIT
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "common/reconstruction/level_morph.h"
#include "common/reconstruction/level_triangles.h"
#include "common/reconstruction/numbers.h"
#include "common/reconstruction/reconstruct.h"
#include "web/core/asset.h"
#include "web/core/error.h"

using namespace eigencast;

struct core_surface {
  std::uint64_t asset = 0;  ///< The number of the one that it follows.
  Reconstructor reconstructor;
  LevelTriangles levels;
  LevelMorph morph;
  std::vector<std::uint32_t> triangles;
  std::vector<float> positions, normals, radii;
  /// Where the image has seams a vertex is drawn once for each of its wedges.
  struct {
    bool are_drawn = false;
    std::uint32_t version = 0;  ///< Of the triangles that they follow.
    std::vector<std::uint32_t> triangles, origins;
    std::vector<float> positions, normals, uvs;
  } wedges;
  core_geometry geometry{};
  std::vector<float> values, room;
  std::vector<std::uint32_t> row_of;  ///< Rows by the source's numbers, 2^32 - 1: it has not arrived;
  std::uint32_t rows_placed = 0;      ///< so many are there.
  core_numbers numbers{};

  void update(const Asset& from) {
    reconstructor.update(from);
    levels.update(from, triangles);
    geometry.triangles_version += 1;
    radii.clear();
  }
  void set_level(const Asset& from, std::uint32_t N);
  void advance(const Asset& from, std::uint32_t N, double px_per_unit, TimeUs now_us);
  void finish(const Asset& from, const LevelMorph& level);
  void make_wedges(const AssetTexture& texture, std::uint32_t N);
};

void core_surface::set_level(const Asset& from, std::uint32_t N) {
  const std::uint64_t before = levels.version();
  levels.set_level(N, triangles);
  if (levels.version() != before) ++geometry.triangles_version;
  if (!from.is_point_cloud() || from.splats.size() < N || radii.size() == N) return;
  radii.resize(N);
  splat_radii(from, N, radii);
  ++geometry.triangles_version;
}

void core_surface::advance(const Asset& from, std::uint32_t N, double px_per_unit, TimeUs now_us) {
  if (morph.drawn() > reconstructor.tiles().rows() || morph.whole() < from.base_count)
    morph.jump(N);  // Another asset's.
  const std::uint32_t coarsest = std::max(1U, std::min(N, morph.whole()));
  morph.advance(N, now_us, from.area > 0 ? MorphPace::of(px_per_unit * std::sqrt(from.area / coarsest)) : MorphPace());
}

/// Normals, of detail as they came with the positions, and both between levels: view/rebuild.cpp.
void core_surface::finish(const Asset& from, const LevelMorph& level) {
  const bool has_detail = reconstructor.has_detail(), are_of_faces = !has_detail && !from.is_point_cloud();
  if (has_detail) level.blend(from.map, normals);
  if (!are_of_faces && !has_detail) return splat_normals(from, positions, normals);
  level.blend(from.map, positions);
  if (are_of_faces) {
    area_normals(positions, triangles, normals);
    level.share(from.map, normals);
  }
  normalise(normals);
}

void core_surface::make_wedges(const AssetTexture& texture, std::uint32_t N) {
  const std::uint32_t end = texture.first_wedge[N];
  if (std::exchange(wedges.version, geometry.triangles_version) != geometry.triangles_version) {
    wedges.triangles.resize(std::min(triangles.size(), 3 * texture.corners.size()));
    for (std::size_t i = 0; i < wedges.triangles.size(); ++i) {
      std::uint32_t wedge = texture.corners[i / 3][i % 3];
      while (wedge >= end) wedge = texture.parent[wedge];
      wedges.triangles[i] = wedge;
    }
    wedges.origins.resize(end);
    for (std::uint32_t v = 0, w = 0; v < N; ++v) {
      for (; w < texture.first_wedge[v + 1]; ++w) wedges.origins[w] = v;
    }
    wedges.uvs.assign(std::size_t{2} * end, -std::numeric_limits<float>::max());
    for (std::uint32_t w = 0; w < end; ++w) {
      if (texture.uvs[w] == AssetTexture::kNone) continue;
      const std::array<float, 2> uv = texture.uv(w);
      std::copy(uv.begin(), uv.end(), &wedges.uvs[std::size_t{2} * w]);
    }
  }
  wedges.positions.resize(std::size_t{3} * end);
  wedges.normals.resize(std::size_t{3} * end);
  for (std::size_t w = 0; w < end; ++w) {
    std::copy_n(&positions[std::size_t{3} * wedges.origins[w]], 3, &wedges.positions[3 * w]);
    std::copy_n(&normals[std::size_t{3} * wedges.origins[w]], 3, &wedges.normals[3 * w]);
  }
}

core_surface* surface_make() {
  return new core_surface;
}

void surface_free(core_surface* surface) {
  delete surface;
}

int32_t surface_update(core_surface* surface, const core_asset* asset) {
  if (surface->asset != asset->number) {
    surface->reconstructor.reset();
    surface->levels.forget();
    surface->triangles.clear();
    surface->reconstructor.reserve(asset->reader.asset());
    surface->row_of.clear();
    surface->rows_placed = 0;
    surface->asset = asset->number;
  }
  const Asset& from = asset->reader.asset();
  if (from.rows_ready < from.base_count)
    return web::failed(fail(ErrorCode::kNotFound, "nothing of the surface has arrived yet"));
  surface->update(from);
  return 0;
}

const core_geometry* surface_rebuild(core_surface* surface, const core_asset* asset, const double* coefficients,
                                     uint32_t count, uint32_t channels, uint32_t rank_used, uint32_t level,
                                     uint32_t is_textured, double px_per_unit, int64_t now_us) {
  const Asset& from = asset->reader.asset();
  const std::uint32_t ready = surface->reconstructor.tiles().rows();
  if (surface->asset != asset->number || ready < from.base_count || ready == 0)
    return web::no(fail(ErrorCode::kInvalidArgument, "the surface follows another asset, or none"));
  if (channels < 3 || count > std::uint64_t{from.rank} * channels)
    return web::no(fail(ErrorCode::kInvalidArgument, "the pose has another size than the surface"));
  const bool morphs = px_per_unit > 0 && !from.is_point_cloud();
  LevelMorph at_once;
  at_once.jump(std::clamp(level, from.base_count, ready));
  if (morphs) surface->advance(from, at_once.drawn(), px_per_unit, now_us);
  const LevelMorph& drawn = morphs ? surface->morph : at_once;
  const std::uint32_t N = drawn.drawn();
  surface->set_level(from, N);
  surface->positions.resize(std::size_t{3} * N);
  surface->normals.resize(surface->positions.size());
  PoseToRebuild pose{{coefficients, count}, channels, surface->positions, {}};
  if (surface->reconstructor.has_detail()) pose.normals = surface->normals;
  const std::uint32_t rows = count / channels;
  surface->reconstructor.rebuild({&pose, 1}, rank_used == 0 ? rows : std::min(rank_used, rows), N);
  surface->finish(from, drawn);
  core_geometry& geometry = surface->geometry;
  const AssetTexture* texture = is_textured != 0 ? from.texture.get() : nullptr;
  const bool had_wedges = std::exchange(surface->wedges.are_drawn, texture != nullptr);
  if (had_wedges != (texture != nullptr)) ++geometry.triangles_version;
  const bool has_normals = !from.is_point_cloud() || from.splats.size() >= N || surface->reconstructor.has_detail();
  geometry.positions = surface->positions.data();
  geometry.normals = has_normals ? surface->normals.data() : nullptr;
  geometry.radii = surface->radii.size() == N ? surface->radii.data() : nullptr;
  geometry.triangles = surface->triangles.data();
  geometry.vertices = N;
  geometry.indices = static_cast<std::uint32_t>(surface->triangles.size());
  geometry.level = N;
  geometry.is_moving = drawn.moving().empty() ? 0 : 1;
  geometry.uvs = nullptr;
  geometry.origins = nullptr;
  if (texture == nullptr) return &geometry;
  surface->make_wedges(*texture, N);
  geometry.positions = surface->wedges.positions.data();
  geometry.normals = surface->wedges.normals.data();
  geometry.triangles = surface->wedges.triangles.data();
  geometry.uvs = surface->wedges.uvs.data();
  geometry.origins = surface->wedges.origins.data();
  geometry.vertices = texture->first_wedge[N];
  geometry.indices = static_cast<std::uint32_t>(surface->wedges.triangles.size());
  return &geometry;
}

const float* surface_points(core_surface* surface, const core_asset* asset, const double* coefficients, uint32_t count,
                            uint32_t channels, const uint32_t* vertices, uint32_t points) {
  const Asset& from = asset->reader.asset();
  const std::uint32_t ready = surface->reconstructor.tiles().rows();
  if (surface->asset != asset->number || channels < 3 || count > std::uint64_t{from.rank} * channels)
    return web::no(fail(ErrorCode::kInvalidArgument, "the surface follows another asset, or the pose is another's"));
  std::vector<float>&all = surface->values, &room = surface->room;
  all.assign(std::size_t{3} * points, std::numeric_limits<float>::quiet_NaN());
  room.resize(std::size_t{3} * ready);
  auto& row_of = surface->row_of;
  row_of.resize(from.vertex_count, ~std::uint32_t{0});
  for (std::uint32_t& row = surface->rows_placed; row < ready; ++row) row_of[from.source_vertex[row]] = row;
  for (std::uint32_t i = 0; i < points; ++i) {
    const std::uint32_t row = vertices[i] < row_of.size() ? row_of[vertices[i]] : ready;
    if (row >= ready) continue;
    const PoseToRebuild pose{{coefficients, count}, channels, {room.data(), std::size_t{3} * (row + 1)}, {}};
    surface->reconstructor.rebuild({&pose, 1}, count / channels, row + 1, row);
    std::copy_n(&room[std::size_t{3} * row], 3, &all[std::size_t{3} * i]);
  }
  return all.data();
}

const core_numbers* surface_numbers(core_surface* surface, const core_asset* asset, const double* coefficients,
                                    uint32_t count, uint32_t is_length) {
  const std::uint32_t N = surface->geometry.level;
  if (surface->asset != asset->number || N > surface->reconstructor.tiles().rows())
    return web::no(fail(ErrorCode::kInvalidArgument, "the surface follows another asset, or none"));
  if (count > std::uint64_t{3} * asset->reader.asset().rank)
    return web::no(fail(ErrorCode::kInvalidArgument, "the pose has another size than the surface"));
  surface->values.resize(N);
  numbers_from_coefficients(surface->reconstructor, {coefficients, count},
                            is_length != 0 ? NumberOf::kLength : NumberOf::kFirst, surface->room, surface->values);
  const auto range = range_without_outliers(surface->values);
  const auto [low, high] = range.value_or(std::array<float, 2>{});
  surface->numbers = {surface->values.data(), low, high, range ? 1U : 0U};
  return &surface->numbers;
}
