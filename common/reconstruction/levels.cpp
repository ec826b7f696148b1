// SPDX-License-Identifier: MIT
#include "common/reconstruction/reconstruct.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>

namespace eigencast {
namespace {

using Vector = std::array<float, 3>;

Vector minus(const Vector& a, const Vector& b) {
  return {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}
Vector cross(const Vector& a, const Vector& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
/// Zero for a zero vector.
Vector unit(const Vector& a) {
  const float length = std::hypot(a[0], a[1], a[2]);
  const float scale = length > 0 ? 1 / length : 0;
  return {a[0] * scale, a[1] * scale, a[2] * scale};
}

}  // namespace

std::vector<std::uint32_t> triangles_at_level(const Asset& asset, std::uint32_t N) {
  assert(asset.base_count <= N && N <= asset.rows_ready);
  const auto known = asset.death.begin() + asset.faces_ready;
  const auto alive = static_cast<std::size_t>(std::lower_bound(asset.death.begin(), known, N) - asset.death.begin());
  std::vector<std::uint32_t> triangles(alive * 3);
  for (std::size_t f = 0; f < alive; ++f) {
    for (std::size_t corner = 0; corner < 3; ++corner) {
      std::uint32_t a = asset.faces[f][corner];
      while (a >= N) a = asset.map[a];
      triangles[3 * f + corner] = a;
    }
  }
  return triangles;
}

void area_normals(std::span<const float> positions, std::span<const std::uint32_t> triangles, std::span<float> sums) {
  assert(sums.size() >= positions.size());
  std::fill_n(sums.begin(), positions.size(), 0.0F);
  for (std::size_t t = 0; t + 3 <= triangles.size(); t += 3) {
    const std::size_t corners[3] = {3 * std::size_t{triangles[t]}, 3 * std::size_t{triangles[t + 1]},
                                    3 * std::size_t{triangles[t + 2]}};
    assert(std::max({corners[0], corners[1], corners[2]}) + 3 <= positions.size());
    const float* a = &positions[corners[0]];
    const float* b = &positions[corners[1]];
    const float* c = &positions[corners[2]];
    const float u[3] = {b[0] - a[0], b[1] - a[1], b[2] - a[2]};
    const float v[3] = {c[0] - a[0], c[1] - a[1], c[2] - a[2]};
    // Twice the area long: summing it weights each face by its area.
    const float normal[3] = {u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]};
    for (const std::size_t corner : corners) {
      for (std::size_t d = 0; d < 3; ++d) sums[corner + d] += normal[d];
    }
  }
}

void normalise(std::span<float> vectors) {
  for (std::size_t i = 0; i + 3 <= vectors.size(); i += 3) {
    // In double: the square of a small face's area underflows in float.
    const double x = vectors[i], y = vectors[i + 1], z = vectors[i + 2];
    const double length = std::sqrt(x * x + y * y + z * z);
    const double scale = length > 0 ? 1 / length : 0;
    vectors[i] = static_cast<float>(x * scale);
    vectors[i + 1] = static_cast<float>(y * scale);
    vectors[i + 2] = static_cast<float>(z * scale);
  }
}

void vertex_normals(std::span<const float> positions, std::span<const std::uint32_t> triangles,
                    std::span<float> normals) {
  area_normals(positions, triangles, normals);
  normalise(normals.first(positions.size()));
}

void splat_normals(const Asset& asset, std::span<const float> positions, std::span<float> normals) {
  const std::size_t N = positions.size() / 3;
  assert(normals.size() >= positions.size());
  if (asset.splats.size() < N) {
    std::fill_n(normals.begin(), positions.size(), 0.0F);
    return;
  }
  const auto point = [&](std::size_t i) {
    return Vector{positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]};
  };
  for (std::size_t i = 0; i < N; ++i) {
    const auto& [first, second] = asset.splats.frame[i];
    const Vector here = point(i);
    const Vector t = unit(minus(point(first), here));
    const Vector m = unit(cross(t, minus(point(second), here)));
    const auto& n = asset.splats.normal[i];
    Vector normal = n;
    if (m != Vector{}) {
      const Vector b = cross(m, t);
      for (std::size_t d = 0; d < 3; ++d) normal[d] = n[0] * t[d] + n[1] * b[d] + n[2] * m[d];
    }
    std::copy(normal.begin(), normal.end(), &normals[3 * i]);
  }
}

void splat_radii(const Asset& asset, std::uint32_t N, std::span<float> radii) {
  assert(asset.base_count <= N && N <= asset.rows_ready && radii.size() >= N);
  const Asset::Splats& splats = asset.splats;
  if (splats.size() < N) {
    std::fill_n(radii.begin(), N, 0.0F);
    return;
  }
  std::copy_n(splats.radius.begin(), N, radii.begin());
  for (std::uint32_t i = asset.base_count; i < N; ++i) radii[asset.map[i]] = splats.parent_radius[i];
}

std::uint32_t level_from_fraction(const Asset& asset, double fraction) {
  const double share = fraction > 0 ? std::min(fraction, 1.0) : 0.0;  // Also where it is not a number.
  const auto wanted = static_cast<std::uint32_t>(std::lround(share * asset.vertex_count));
  return std::min(std::max(wanted, asset.base_count), asset.rows_ready);
}

}  // namespace eigencast
