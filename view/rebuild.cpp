// SPDX-License-Identifier: MIT
#include "view/rebuild.h"

#include <algorithm>
#include <cassert>
#include <tuple>
#include <utility>
#include <vector>

#include "common/reconstruction/level_triangles.h"

namespace eigencast {
namespace {

/// Undoes the morph of the last rebuild: rows that are kept must hold the pose itself.
void restore_unmorphed(SurfaceGeometry& geometry) {
  if (geometry.unmorphed.empty()) return;
  assert(geometry.positions.size() == 3 * std::size_t{geometry.unmorphed_first} + geometry.unmorphed.size() ||
         geometry.positions.empty());
  if (!geometry.positions.empty())
    std::copy(geometry.unmorphed.begin(), geometry.unmorphed.end(),
              geometry.positions.begin() + 3 * std::ptrdiff_t{geometry.unmorphed_first});
  geometry.unmorphed.clear();
}

/// With detail all rows are rebuilt, because the normals kept are morphed ones.
std::uint32_t first_of(const RebuildJob& job) {
  return job.basis->has_detail() ? 0 : job.first;
}

void multiply(std::span<const RebuildJob> jobs) {
  std::vector<const RebuildJob*> order;
  for (const RebuildJob& job : jobs) {
    restore_unmorphed(*job.geometry);
    job.geometry->positions.resize(3 * std::size_t{job.vertices()});
    if (job.basis->has_detail()) job.geometry->normals.resize(job.geometry->positions.size());
    order.push_back(&job);
  }
  const auto key = [](const RebuildJob* job) {
    return std::tuple(job->basis.get(), job->rank, job->vertices(), first_of(*job));
  };
  std::sort(order.begin(), order.end(), [&](auto* a, auto* b) { return key(a) < key(b); });
  std::vector<PoseToRebuild> poses;
  for (std::size_t i = 0; i < order.size(); ++i) {
    const RebuildJob& job = *order[i];
    poses.push_back({job.C, job.channels, job.geometry->positions, {}});
    if (job.basis->has_detail()) poses.back().normals = job.geometry->normals;
    if (i + 1 < order.size() && key(order[i + 1]) == key(&job)) continue;
    job.basis->rebuild(poses, job.rank, job.vertices(), first_of(job));
    poses.clear();
  }
}

/// Those of the level's faces, of unit length.
void make_face_normals(const RebuildJob& job, std::vector<float>& normals) {
  SurfaceGeometry& geometry = *job.geometry;
  normals.resize(geometry.positions.size());
  if (geometry.corners) {
    const CornerNormals& corners = *geometry.corners;
    geometry.extra_normals.resize(3 * corners.origins(job.vertices()).size());
    area_normals(geometry.positions, geometry.corner_triangles, corners, normals, geometry.extra_normals);
    corners.share(*job.level, normals, geometry.extra_normals);
    normalise(geometry.extra_normals);
  } else {
    area_normals(geometry.positions, geometry.triangles, normals);
    job.level->share(job.asset->map, normals);
  }
  normalise(normals);
}

/// A surface with normals of its own has those of its faces where vertices have several.
void take_parted_normals(const RebuildJob& job) {
  std::vector<float> normals;
  make_face_normals(job, normals);
  for (const std::size_t v : job.geometry->corners->origins(job.vertices()))
    std::copy_n(&normals[3 * v], 3, &job.geometry->normals[3 * v]);
}

void finish(const RebuildJob& job) {
  const Asset& asset = *job.asset;
  SurfaceGeometry& geometry = *job.geometry;
  std::vector<float>& positions = geometry.positions;
  geometry.unmorphed_first = job.level->whole();
  geometry.unmorphed.assign(positions.begin() + 3 * std::ptrdiff_t{geometry.unmorphed_first}, positions.end());
  if (asset.is_point_cloud() && job.level_changed) fill_radii(asset, *job.level, geometry);
  if (asset.is_point_cloud() && !job.basis->has_detail()) {
    geometry.normals.resize(3 * geometry.radii.size());
    if (!geometry.radii.empty()) splat_normals(asset, positions, geometry.normals);
  }
  if (asset.is_point_cloud() || job.basis->has_detail()) {
    // These normals belong to vertices, not to the level's faces.
    if (!geometry.normals.empty()) job.level->blend(asset.map, geometry.normals);
    normalise(geometry.normals);
    job.level->blend(asset.map, positions);
    if (geometry.corners) take_parted_normals(job);
    return;
  }
  job.level->blend(asset.map, positions);
  make_face_normals(job, geometry.normals);
}

/// What a level without a new pose keeps: normals are compared, positions known.
struct Kept {
  std::vector<float> normals, extra_normals;
  std::uint32_t vertices = 0;  ///< Leading ones whose positions stay.
};

Kept take_kept(const RebuildJob& job) {
  SurfaceGeometry& geometry = *job.geometry;
  if (job.first == 0) {
    geometry.position_blocks.clear();
    geometry.normal_blocks.clear();
    geometry.extra_blocks.clear();
    return {};
  }
  return {std::move(geometry.normals), std::move(geometry.extra_normals),
          std::min({job.first, geometry.unmorphed_first, job.level->whole()})};
}

std::size_t blocks_of(std::size_t count) {
  return (count + LevelTriangles::kBlock - 1) / LevelTriangles::kBlock;
}

}  // namespace

void mark_from(std::size_t first, std::size_t count, std::uint64_t now, BlockVersions& blocks) {
  blocks.resize(blocks_of(count), now - 1);
  for (std::size_t b = first / LevelTriangles::kBlock; b < blocks.size(); ++b) blocks[b] = now;
}

void mark_different(std::span<const float> before, std::span<const float> values, std::uint64_t now,
                    BlockVersions& blocks) {
  blocks.resize(blocks_of(values.size()), now - 1);
  for (std::size_t b = 0; b < blocks.size(); ++b) {
    const std::size_t begin = b * LevelTriangles::kBlock, end = std::min(begin + LevelTriangles::kBlock, values.size());
    if (end > before.size() || !std::equal(&values[begin], &values[begin] + (end - begin), &before[begin]))
      blocks[b] = now;
  }
}

void fill_radii(const Asset& asset, const LevelMorph& level, SurfaceGeometry& geometry) {
  const std::uint32_t N = level.drawn();
  const std::vector<float> before = std::exchange(geometry.radii, {});
  std::vector<float>& radii = geometry.radii;
  ++geometry.level_version;
  radii.resize(asset.splats.size() >= N ? N : 0);
  if (radii.empty()) return;
  // A new disc starts as large as its parent, which shrinks as the new one appears.
  splat_radii(asset, level.whole(), radii);
  for (std::uint32_t i = level.whole(); i < N; ++i) {
    const float weight = level.weight(i);
    float& parent = radii[asset.map[i]];
    radii[i] = parent + weight * (asset.splats.radius[i] - parent);
    parent += weight * (asset.splats.parent_radius[i] - parent);
  }
  mark_different(before, radii, geometry.level_version, geometry.radius_blocks);
}

SurfaceRebuilder::Cost CpuRebuilder::rebuild(std::span<const RebuildJob> jobs) {
  const TimeUs start = steady_now_us();
  std::vector<Kept> kept;
  for (const RebuildJob& job : jobs) kept.push_back(take_kept(job));
  multiply(jobs);
  const TimeUs multiplied = steady_now_us();
  for (std::size_t i = 0; i < jobs.size(); ++i) {
    finish(jobs[i]);
    if (jobs[i].first == 0) continue;
    SurfaceGeometry& geometry = *jobs[i].geometry;
    const std::uint64_t now = geometry.pose_version + 1;  // by SurfaceView::finish()
    mark_from(3 * std::size_t{kept[i].vertices}, geometry.positions.size(), now, geometry.position_blocks);
    mark_different(kept[i].normals, geometry.normals, now, geometry.normal_blocks);
    mark_different(kept[i].extra_normals, geometry.extra_normals, now, geometry.extra_blocks);
  }
  return {multiplied - start, steady_now_us() - multiplied};
}

}  // namespace eigencast
