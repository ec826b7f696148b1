// SPDX-License-Identifier: MIT
#include "view/rebuild.h"

#include <algorithm>
#include <cassert>
#include <tuple>
#include <vector>

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
    return;
  }
  job.level->blend(asset.map, positions);
  geometry.normals.resize(positions.size());
  area_normals(positions, geometry.triangles, geometry.normals);
  job.level->share(asset.map, geometry.normals);
  normalise(geometry.normals);
}

}  // namespace

void fill_radii(const Asset& asset, const LevelMorph& level, SurfaceGeometry& geometry) {
  const std::uint32_t N = level.drawn();
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
}

SurfaceRebuilder::Cost CpuRebuilder::rebuild(std::span<const RebuildJob> jobs) {
  const TimeUs start = steady_now_us();
  multiply(jobs);
  const TimeUs multiplied = steady_now_us();
  for (const RebuildJob& job : jobs) finish(job);
  return {multiplied - start, steady_now_us() - multiplied};
}

}  // namespace eigencast
