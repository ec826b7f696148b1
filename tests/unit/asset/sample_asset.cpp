// SPDX-License-Identifier: MIT
#include "sample_asset.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <utility>

namespace eigencast {
namespace {

using Point = std::array<double, 3>;
using Corners = std::array<std::uint32_t, 3>;

struct Sphere {
  std::vector<Point> points;
  std::vector<Corners> faces;
  std::vector<std::uint32_t> map;
};

Point unit(Point p) {
  const double length = std::sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
  return {p[0] / length, p[1] / length, p[2] / length};
}

Sphere icosahedron() {
  const double g = (1 + std::sqrt(5.0)) / 2;
  Sphere s;
  for (const Point& p : std::initializer_list<Point>{{-1, g, 0},
                                                     {1, g, 0},
                                                     {-1, -g, 0},
                                                     {1, -g, 0},
                                                     {0, -1, g},
                                                     {0, 1, g},
                                                     {0, -1, -g},
                                                     {0, 1, -g},
                                                     {g, 0, -1},
                                                     {g, 0, 1},
                                                     {-g, 0, -1},
                                                     {-g, 0, 1}}) {
    s.points.push_back(unit(p));
  }
  s.faces = {{0, 11, 5},  {0, 5, 1},  {0, 1, 7},  {0, 7, 10}, {0, 10, 11}, {1, 5, 9}, {5, 11, 4},
             {11, 10, 2}, {10, 7, 6}, {7, 1, 8},  {3, 9, 4},  {3, 4, 2},   {3, 2, 6}, {3, 6, 8},
             {3, 8, 9},   {4, 9, 5},  {2, 4, 11}, {6, 2, 10}, {8, 6, 7},   {9, 8, 1}};
  // The base is the first four vertices; the others go to a neighbour before them.
  s.map = {0, 1, 2, 3, 3, 0, 2, 0, 3, 1, 0, 0};
  return s;
}

void subdivide(Sphere& s) {
  std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> middles;
  const auto middle = [&](std::uint32_t a, std::uint32_t b) {
    const auto [at, fresh] = middles.try_emplace(std::minmax(a, b), static_cast<std::uint32_t>(s.points.size()));
    if (fresh) {
      const Point &p = s.points[a], &q = s.points[b];
      s.map.push_back(std::min(a, b));
      s.points.push_back(unit({p[0] + q[0], p[1] + q[1], p[2] + q[2]}));
    }
    return at->second;
  };
  std::vector<Corners> finer;
  for (const auto& [a, b, c] : s.faces) {
    const std::uint32_t ab = middle(a, b), bc = middle(b, c), ca = middle(c, a);
    finer.insert(finer.end(), {{a, ab, ca}, {ab, b, bc}, {ca, bc, c}, {ab, bc, ca}});
  }
  s.faces = std::move(finer);
}

/// The greatest level at which the face has collapsed; 0 for a face of the base.
std::uint32_t death_of(const Asset& asset, Corners face) {
  for (std::uint32_t N = asset.vertex_count; N-- > asset.base_count;) {
    for (std::uint32_t& corner : face) {
      if (corner >= N) corner = asset.map[corner];
    }
    if (face[0] == face[1] || face[1] == face[2] || face[2] == face[0]) return N;
  }
  return 0;
}

void add_faces(Asset& asset, const std::vector<Corners>& faces) {
  std::vector<std::pair<std::uint32_t, Corners>> by_death;
  for (const Corners& face : faces) by_death.emplace_back(death_of(asset, face), face);
  std::stable_sort(by_death.begin(), by_death.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  for (const auto& [death, face] : by_death) {
    asset.death.push_back(death);
    asset.faces.push_back(face);
  }
  asset.face_total = asset.faces_ready = static_cast<std::uint32_t>(faces.size());
}

/// Frames from the rows next to a row in number; normals as if frames were the axes.
void add_splats(Asset& asset, const std::vector<Point>& points) {
  for (std::uint32_t i = 0; i < points.size(); ++i) {
    asset.splats.frame.push_back(i < 4 ? std::array{(i + 1) % 4, (i + 2) % 4} : std::array{i - 1, i - 3});
    asset.splats.normal.push_back(
        {static_cast<float>(points[i][0]), static_cast<float>(points[i][1]), static_cast<float>(points[i][2])});
    asset.splats.radius.push_back(0.01F + 0.3F / static_cast<float>(i + 1));
    asset.splats.parent_radius.push_back(i < asset.base_count ? 0 : 0.01F);
  }
}

}  // namespace

std::uint32_t corner_at_level(const Asset& asset, std::uint32_t a, std::uint32_t N) {
  while (a >= N) a = asset.map[a];
  return a;
}

Asset sample_asset(int subdivisions, std::uint32_t rank, bool cloud) {
  Sphere sphere = icosahedron();
  for (int i = 0; i < subdivisions; ++i) subdivide(sphere);
  Asset asset;
  const auto n = static_cast<std::uint32_t>(sphere.points.size());
  asset.vertex_count = asset.rows_ready = n;
  asset.rank = rank;
  asset.base_count = 4;
  asset.band_ends = rank > 4 ? std::vector<std::uint32_t>{4, rank} : std::vector<std::uint32_t>{rank};
  asset.map = std::move(sphere.map);
  asset.area = 12.5;
  asset.name = "icosphere";
  asset.metres_per_unit = 0.01;
  asset.box_low = {-1, -1, -1};
  asset.box_high = {1, 1, 1};
  asset.origin = {10, 20, 30};
  for (std::uint32_t i = 0; i < n; ++i) {
    asset.source_vertex.push_back((i * 11 + 3) % n);  // a permutation: no n here is a multiple of 11
    asset.mass.push_back(static_cast<float>(asset.area / n) * (1.0F + 0.125F * static_cast<float>(i % 3)));
    const auto& [x, y, z] = sphere.points[i];
    for (std::uint32_t k = 0; k < rank; ++k) {
      const double wave = std::cos(0.3 * k * x + 0.2) * std::cos(0.23 * k * y - 0.1) * std::cos(0.17 * k * z + 0.4);
      asset.floats.push_back(static_cast<float>(k == 0 ? 0.25 : k == 1 ? x : k == 2 ? y : k == 3 ? z : wave));
    }
  }
  asset.rest.assign(std::size_t{rank} * 3, 0);
  for (std::uint32_t axis = 0; axis < 3 && axis + 1 < rank; ++axis) asset.rest[(axis + 1) * 3 + axis] = 1;
  if (cloud) {
    add_splats(asset, sphere.points);
  } else {
    add_faces(asset, sphere.faces);
  }
  return asset;
}

Asset::Detail sample_detail(const Asset& asset, std::uint32_t axes) {
  Asset::Detail detail;
  detail.axes = axes;
  for (std::uint32_t k = 0; k < asset.rank; ++k) detail.steps.push_back(k == 5 ? 0 : 1e-3F * static_cast<float>(k + 1));
  for (std::uint32_t i = 0; i < asset.vertex_count; ++i) {
    for (std::uint32_t k = 0; k < asset.rank; ++k) {
      const auto entry = [&](std::uint32_t seed) {
        const std::uint32_t hash = (i * 131 + k * 31 + seed) * 2654435761U;
        return static_cast<std::int16_t>(k == 5 ? 0 : static_cast<int>(hash >> 16) - 32768 + (hash >> 31 == 0 ? 1 : 0));
      };
      detail.along_x.push_back(entry(1));
      detail.along_y.push_back(entry(2));
    }
    const float t = 0.1F * static_cast<float>(i), height = std::sin(t), flat = std::cos(t);
    detail.offset.push_back({axes == 3 ? 0.02F * flat : 0, axes == 3 ? -0.01F : 0, 0.03F * height});
    detail.normal.push_back({flat * std::cos(3 * t), flat * std::sin(3 * t), height});
  }
  return detail;
}

}  // namespace eigencast
