// SPDX-License-Identifier: MIT
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "common/core/worker_team.h"
#include "common/progressive/prefix.h"
#include "common/progressive/splats.h"
#include "common/surface/checks/surface_distance.h"
#include "sdk/bake_parts.h"

namespace eigencast {
namespace {

constexpr std::size_t kLevels = 16;
constexpr std::size_t kPosesSkipped = 1;  // after each one
constexpr std::size_t kOfMean = 512, kOfLargest = 4096;  // vertices of a pose that are looked at

/// From the base up, each as many times as large as the one before; fewer where they would be equal.
std::vector<std::uint32_t> levels_of(const Asset& asset) {
  std::vector<std::uint32_t> levels;
  const double q = asset.base_count, ratio = asset.vertex_count / q;
  for (std::size_t i = 0; i < kLevels; ++i) {
    const auto rows = static_cast<std::uint32_t>(std::lround(q * std::pow(ratio, static_cast<double>(i) / kLevels)));
    if (rows < asset.vertex_count && (levels.empty() || rows > levels.back())) levels.push_back(rows);
  }
  return levels;
}

std::vector<Vec3> in_order(const Asset& asset, std::span<const Vec3> positions) {
  std::vector<Vec3> rows;
  rows.reserve(asset.vertex_count);
  for (const std::uint32_t source : asset.source_vertex) rows.push_back(positions[source]);
  return rows;
}

/// Squared distances as they come, by mass, and the farthest.
struct Distances {
  double sum = 0, masses = 0, farthest = 0;
  void add(double squared, double mass) {
    sum += mass * squared;
    masses += mass;
    farthest = std::max(farthest, squared);
  }
  /// share: of all mass that these vertices stand for.
  GeometricError error(std::uint32_t rows, double share, double diagonal) const {
    if (masses == 0 || diagonal == 0) return {rows, 0, 0};
    const double largest = std::sqrt(farthest) / diagonal;
    const double rms = std::min(std::sqrt(share * sum / masses) / diagonal, largest);
    return {rows, static_cast<float>(rms), static_cast<float>(largest)};
  }
};

Distances distances_of_mesh(const Asset& asset, std::span<const std::vector<Vec3>> poses, std::uint32_t N) {
  std::vector<Face> faces(asset.faces.begin(), asset.faces.begin() + prefix_face_count(asset.death, N));
  for (Face& face : faces) {
    for (std::uint32_t& corner : face) corner = prefix_corner(asset.map, corner, N);
  }
  SurfaceDistance drawn({poses[0].data(), N}, faces);
  Distances found;
  const auto for_some = [&](std::size_t wanted, const auto& visit) {
    for (std::size_t i = N; i < asset.vertex_count; i += (asset.vertex_count - N + wanted - 1) / wanted) visit(i);
  };
  for (const std::vector<Vec3>& pose : poses) {
    if (&pose != &poses[0]) drawn.move_to({pose.data(), N});
    for_some(kOfMean, [&](std::size_t i) { found.add(drawn.squared(pose[i]), double{asset.mass[i]}); });
    std::vector<Vec3> others;
    for_some(kOfLargest, [&](std::size_t i) { others.push_back(pose[i]); });
    found.farthest = farthest_squared(others, drawn, {}, found.farthest);
  }
  return found;
}

/// From each point to the disc that covers it.
Distances distances_of_points(const Asset& asset, std::span<const Vec3> rest, std::uint32_t N) {
  const Asset::Splats& splats = asset.splats;
  std::vector<float> radius(splats.radius.begin(), splats.radius.begin() + N);
  for (std::uint32_t i = asset.base_count; i < N; ++i) radius[asset.map[i]] = splats.parent_radius[i];
  Distances found;
  for (std::uint32_t i = N; i < asset.vertex_count; ++i) {
    const std::uint32_t disc = prefix_corner(asset.map, i, N);
    const auto [first, second] = splats.frame[disc];
    const auto frame = frame_from_points(rest[disc], rest[first], rest[second]);
    const Vec3 away = rest[i] - rest[disc];
    double height = 0;
    for (std::size_t axis = 0; axis < 3; ++axis) height += double{splats.normal[disc][axis]} * dot(frame[axis], away);
    const double across = std::sqrt(std::max(dot(away, away) - height * height, 0.0));
    const double beyond = std::max(across - double{radius[disc]}, 0.0);
    found.add(height * height + beyond * beyond, double{asset.mass[i]});
  }
  return found;
}

}  // namespace

std::vector<GeometricError> level_errors_of(const Asset& asset, const Surface& surface,
                                            std::span<const std::vector<Vec3>> poses) {
  if (asset.is_point_cloud() && asset.splats.size() == 0) return {};
  std::vector<std::vector<Vec3>> moved{in_order(asset, surface.positions)};
  for (std::size_t i = 0; i < poses.size(); i += kPosesSkipped + 1) moved.push_back(in_order(asset, poses[i]));
  const std::vector<std::uint32_t> levels = levels_of(asset);
  std::vector<GeometricError> errors(levels.size());
  worker_team().run(levels.size(), [&](std::size_t task) {
    const std::size_t at = levels.size() - 1 - task;  // those of most faces first
    const std::uint32_t N = levels[at];
    const Distances found =
        asset.is_point_cloud() ? distances_of_points(asset, moved[0], N) : distances_of_mesh(asset, moved, N);
    double mass = 0;
    for (std::size_t i = N; i < asset.vertex_count; ++i) mass += double{asset.mass[i]};
    errors[at] = found.error(N, mass / asset.area, asset.diagonal());
  });
  return errors;
}

}  // namespace eigencast
