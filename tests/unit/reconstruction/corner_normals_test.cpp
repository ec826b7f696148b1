// SPDX-License-Identifier: MIT
#include "common/reconstruction/corner_normals.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <set>
#include <utility>

#include "common/reconstruction/level_triangles.h"
#include "common/reconstruction/reconstruct.h"

namespace eigencast {
namespace {

constexpr double kCosine = 0.766044443;  // of 40 degrees

struct Mesh {
  std::vector<float> positions;
  std::vector<Corners> faces;
  std::uint32_t add(double x, double y, double z) {
    for (const double value : {x, y, z}) positions.push_back(static_cast<float>(value));
    return vertices() - 1;
  }
  std::uint32_t vertices() const { return static_cast<std::uint32_t>(positions.size() / 3); }
};

/// A mesh of one level.
CornerNormals grouped(const Mesh& mesh, Parting parting = Parting::kByAngle) {
  std::vector<std::uint32_t> map(mesh.vertices()), death(mesh.faces.size());
  const std::vector<Parting> partings(mesh.vertices(), parting);
  return {{mesh.vertices(), mesh.vertices(), map, mesh.faces, death, mesh.positions}, partings, kCosine};
}

/// The numbers of a vertex' normals.
std::set<std::uint32_t> numbers_at(const CornerNormals& corners, const Mesh& mesh, std::uint32_t vertex) {
  std::set<std::uint32_t> numbers;
  for (std::size_t i = 0; i < 3 * mesh.faces.size(); ++i) {
    if (mesh.faces[i / 3][i % 3] == vertex) numbers.insert(corners.empty() ? vertex : corners.at(i, vertex));
  }
  return numbers;
}

/// Unit normals by number.
std::vector<std::array<float, 3>> unit_normals(const CornerNormals& corners, const Mesh& mesh) {
  std::vector<std::uint32_t> triangles;
  for (std::size_t i = 0; i < 3 * mesh.faces.size(); ++i) triangles.push_back(corners.at(i, mesh.faces[i / 3][i % 3]));
  std::vector<float> sums(mesh.positions.size()), extras(3 * corners.origins().size());
  area_normals(mesh.positions, triangles, corners, sums, extras);
  sums.insert(sums.end(), extras.begin(), extras.end());
  normalise(sums);
  std::vector<std::array<float, 3>> normals;
  for (std::size_t i = 0; i < sums.size(); i += 3) normals.push_back({sums[i], sums[i + 1], sums[i + 2]});
  return normals;
}

float dot(const std::array<float, 3>& a, const std::array<double, 3>& b) {
  return static_cast<float>(a[0] * b[0] + a[1] * b[1] + a[2] * b[2]);
}

Mesh cube() {
  Mesh mesh;
  for (int i = 0; i < 8; ++i) mesh.add(i & 1, i >> 1 & 1, i >> 2 & 1);
  for (const auto& q : {std::array{0U, 2U, 3U, 1U}, std::array{4U, 5U, 7U, 6U}, std::array{0U, 1U, 5U, 4U},
                        std::array{2U, 6U, 7U, 3U}, std::array{0U, 4U, 6U, 2U}, std::array{1U, 3U, 7U, 5U}})
    mesh.faces.insert(mesh.faces.end(), {Corners{q[0], q[1], q[2]}, Corners{q[0], q[2], q[3]}});
  return mesh;
}

/// Around the y axis, from y = 0 to 1; its quads are cut now one way, now the other, so that each vertex has as much of
/// the quads at its sides. top: its radius there; 0: a cone. Points down there is the middle of the base.
Mesh turned(std::uint32_t sides, double top) {
  Mesh mesh;
  const auto around = [&](std::uint32_t i, double radius, double y) {
    const double angle = 2 * M_PI * i / sides;
    return mesh.add(radius * std::cos(angle), y, -radius * std::sin(angle));
  };
  for (std::uint32_t i = 0; i < sides; ++i) around(i, 1, 0);
  for (std::uint32_t i = 0; i < sides && top > 0; ++i) around(i, top, 1);
  const std::uint32_t low = mesh.add(0, 0, 0), high = mesh.add(0, 1, 0);
  for (std::uint32_t i = 0; i < sides; ++i) {
    const std::uint32_t next = (i + 1) % sides, up = i + sides, up_next = next + sides;
    mesh.faces.push_back({low, next, i});
    if (top == 0) {
      mesh.faces.push_back({high, i, next});
      continue;
    }
    mesh.faces.push_back({high, up, up_next});
    if (i % 2 == 0)
      mesh.faces.insert(mesh.faces.end(), {Corners{i, next, up_next}, Corners{i, up_next, up}});
    else
      mesh.faces.insert(mesh.faces.end(), {Corners{i, next, up}, Corners{next, up_next, up}});
  }
  return mesh;
}

TEST(CornerNormals, ACubesCornersHaveThree) {
  const Mesh mesh = cube();
  const CornerNormals corners = grouped(mesh);
  EXPECT_EQ(corners.origins().size(), 16U);
  EXPECT_EQ(corners.origins(3).size(), 6U);
  const auto normals = unit_normals(corners, mesh);
  for (std::uint32_t v = 0; v < 8; ++v) EXPECT_EQ(numbers_at(corners, mesh, v).size(), 3U);
  for (std::size_t i = 0; i < 3 * mesh.faces.size(); ++i) {
    const auto& normal = normals[corners.at(i, mesh.faces[i / 3][i % 3])];
    for (const std::size_t other : {3 * (i / 3), 3 * (i / 3) + 1})
      EXPECT_EQ(normal, normals[corners.at(other, mesh.faces[i / 3][other % 3])]) << "each face is flat";
    EXPECT_EQ(std::abs(normal[0]) + std::abs(normal[1]) + std::abs(normal[2]), 1) << "each along an axis";
  }
  EXPECT_TRUE(grouped(mesh, Parting::kNone).empty());
}

TEST(CornerNormals, ACylindersSidesAreRoundAndItsCapsFlat) {
  const Mesh mesh = turned(12, 1);
  const CornerNormals corners = grouped(mesh);
  EXPECT_EQ(corners.origins().size(), 24U) << "one more at the rims";
  const auto normals = unit_normals(corners, mesh);
  for (std::size_t i = 0; i < 3 * mesh.faces.size(); ++i) {
    const std::uint32_t v = mesh.faces[i / 3][i % 3];
    const auto& normal = normals[corners.at(i, v)];
    EXPECT_LE(numbers_at(corners, mesh, v).size(), 2U);
    const float* p = &mesh.positions[std::size_t{3} * v];
    const bool is_cap = mesh.faces[i / 3][0] >= 24;
    const std::array<double, 3> wanted =
        is_cap ? std::array{0.0, p[1] > 0 ? 1.0 : -1.0, 0.0} : std::array{double{p[0]}, 0.0, double{p[2]}};
    EXPECT_NEAR(dot(normal, wanted), 1, 1e-6);
  }
}

TEST(CornerNormals, AConesTipIsSmoothAPyramidsIsNot) {
  const Mesh cone = turned(16, 0), pyramid = turned(4, 0);
  const CornerNormals round = grouped(cone), sharp = grouped(pyramid);
  EXPECT_EQ(numbers_at(round, cone, 17), std::set<std::uint32_t>{17});
  EXPECT_EQ(numbers_at(sharp, pyramid, 5).size(), 4U);
  for (std::uint32_t v = 0; v < 16; ++v) EXPECT_EQ(numbers_at(round, cone, v).size(), 2U) << "of its base";
  for (std::uint32_t v = 0; v < 4; ++v) EXPECT_EQ(numbers_at(sharp, pyramid, v).size(), 3U);
  EXPECT_NEAR(unit_normals(round, cone)[17][1], 1, 1e-6);
}

/// Two triangles with an edge, bent by `degrees`.
Mesh fold(double degrees) {
  Mesh mesh;
  for (const auto& [x, y] : {std::pair(0, 0), std::pair(0, 1), std::pair(1, 0)}) mesh.add(x, y, 0);
  mesh.add(-std::cos(degrees / 57.29577951), 0, std::sin(degrees / 57.29577951));
  mesh.faces = {{0, 1, 2}, {1, 0, 3}};
  std::swap(mesh.faces[0][0], mesh.faces[0][1]);
  std::swap(mesh.faces[1][0], mesh.faces[1][1]);
  return mesh;
}

TEST(CornerNormals, EdgesPartFromTheAngleOnAndWhereTheyAreKnownTo) {
  EXPECT_TRUE(grouped(fold(39)).empty());
  EXPECT_TRUE(grouped(fold(-39)).empty());
  for (const double degrees : {41, -41, 90, 179}) {
    const Mesh mesh = fold(degrees);
    const CornerNormals corners = grouped(mesh);
    EXPECT_EQ(numbers_at(corners, mesh, 0).size(), 2U) << degrees;
    EXPECT_EQ(numbers_at(corners, mesh, 1).size(), 2U) << degrees;
    EXPECT_EQ(numbers_at(corners, mesh, 2).size(), 1U) << "at the boundary";
  }
  EXPECT_EQ(grouped(fold(20), Parting::kKnown).origins().size(), 2U);
  EXPECT_TRUE(grouped(fold(0), Parting::kKnown).empty());
  // A flat strip that goes on beside the fold: only the fold parts.
  Mesh mesh = fold(20);
  mesh.add(1, 1, 0);
  mesh.faces.push_back({1, 2, 4});
  const CornerNormals corners = grouped(mesh, Parting::kKnown);
  EXPECT_EQ(numbers_at(corners, mesh, 1).size(), 2U);
  EXPECT_EQ(numbers_at(corners, mesh, 2).size(), 1U);
}

TEST(CornerNormals, WhatIsNoSurfaceIsParted) {
  Mesh flat = fold(0);
  std::swap(flat.faces[1][0], flat.faces[1][1]);
  EXPECT_EQ(grouped(flat).origins().size(), 2U) << "turned the other way, so that the sum would be nothing";
  Mesh three = fold(0);
  three.add(0, 0, 1);
  three.faces.push_back({0, 1, 4});
  EXPECT_EQ(grouped(three).origins().size(), 4U) << "three faces at an edge";
  Mesh twice = fold(0);
  twice.faces.push_back(twice.faces[0]);
  EXPECT_EQ(numbers_at(grouped(twice), twice, 2).size(), 2U);
  Mesh without_area = fold(90);
  without_area.faces.push_back({0, 0, 1});
  without_area.faces.push_back({2, 2, 2});
  without_area.add(0, 0.5, 0);
  without_area.faces.push_back({0, 1, 4});
  const CornerNormals corners = grouped(without_area);
  EXPECT_EQ(corners.origins().size(), 2U) << "as without them";
  for (std::size_t i = 6; i < 15; ++i)
    EXPECT_LT(corners.at(i, without_area.faces[i / 3][i % 3]), corners.vertices()) << "the vertices' first";
  for (const auto& normal : unit_normals(corners, without_area)) {
    for (const float value : normal) EXPECT_TRUE(std::isfinite(value));
  }
}

TEST(CornerNormals, AVertexMayHaveManyFaces) {
  constexpr std::uint32_t kFaces = 100'000;
  Mesh smooth, zigzag, book;
  for (Mesh* mesh : {&smooth, &zigzag, &book}) mesh->add(0, 0, 0);
  book.add(0, 0, 1);
  for (std::uint32_t i = 0; i < kFaces; ++i) {
    const double angle = 2 * M_PI * i / kFaces;
    smooth.add(std::cos(angle), std::sin(angle), 0);
    zigzag.add(std::cos(angle), std::sin(angle), i % 2 == 0 ? 0.1 : -0.1);
    book.add(std::cos(angle), std::sin(angle), 0);
    smooth.faces.push_back({0, 1 + i, 1 + (i + 1) % kFaces});
    zigzag.faces.push_back(smooth.faces.back());
    book.faces.push_back({0, 1, 2 + i});
  }
  EXPECT_TRUE(grouped(smooth).empty());
  EXPECT_EQ(numbers_at(grouped(zigzag), zigzag, 0).size(), kFaces);
  EXPECT_EQ(numbers_at(grouped(book), book, 0).size(), kFaces);
}

/// Two strips that meet at right angles, contracted from their end: columns of c, on the edge, a and b, beside it.
struct Gutter {
  static constexpr std::uint32_t kColumns = 9;
  Gutter() {
    asset.base_count = 6;
    for (std::uint32_t i = 0; i < kColumns; ++i) {
      for (const auto& [y, z] : {std::pair(0, 0), std::pair(1, 0), std::pair(0, 1)}) {
        mesh.add(i + 0.1 * z, y, z);
        asset.map.push_back(i < 2 ? static_cast<std::uint32_t>(asset.map.size()) : 3 * i - 3 + y + 2 * z);
      }
      if (i == 0) continue;
      const std::uint32_t c = 3 * i, a = c + 1, b = c + 2;
      asset.faces.insert(asset.faces.end(), {{c - 3, c, a - 3}, {c - 3, b - 3, c}, {a - 3, c, a}, {b - 3, b, c}});
      for (const std::uint32_t death : {c, c, a, b}) asset.death.push_back(i == 1 ? 0 : death);
    }
    asset.vertex_count = asset.rows_ready = mesh.vertices();
    asset.face_total = asset.faces_ready = static_cast<std::uint32_t>(asset.faces.size());
    levels.update(asset, triangles);
    const std::vector<Parting> partings(mesh.vertices(), Parting::kByAngle);
    corners = {{mesh.vertices(), asset.base_count, levels.map(), levels.faces(), levels.death(), mesh.positions},
               partings,
               kCosine};
  }
  std::vector<std::uint32_t> numbers() const {
    std::vector<std::uint32_t> all;
    for (std::size_t i = 0; i < triangles.size(); ++i) all.push_back(corners.at(i, triangles[i]));
    return all;
  }
  /// Of faces' normals, by numbers.
  std::vector<float> sums(const LevelMorph& level) {
    levels.set_level(level.drawn(), triangles);
    std::vector<float> positions(mesh.positions.begin(), mesh.positions.begin() + 3 * std::ptrdiff_t{level.drawn()});
    level.blend(levels.map(), positions);
    std::vector<float> sums(mesh.positions.size()), extras(3 * corners.origins().size());
    area_normals(positions, numbers(), corners, sums, extras);
    corners.share(level, sums, extras);
    sums.insert(sums.end(), extras.begin(), extras.end());
    return sums;
  }

  Mesh mesh;
  Asset asset;
  LevelTriangles levels;
  std::vector<std::uint32_t> triangles;
  CornerNormals corners;
};

TEST(CornerNormals, SidesOfAnEdgeStayApartAtEveryLevel) {
  Gutter gutter;
  EXPECT_EQ(gutter.corners.origins().size(), Gutter::kColumns);
  for (std::uint32_t N = 3 * Gutter::kColumns; N >= 6; --N) {
    gutter.levels.set_level(N, gutter.triangles);
    const std::vector<std::uint32_t> numbers = gutter.numbers();
    std::set<std::pair<std::uint32_t, bool>> on_edge;
    std::set<std::uint32_t> used;
    for (std::size_t i = 0; i < numbers.size(); ++i) {
      ASSERT_EQ(gutter.corners.origin(numbers[i]), gutter.triangles[i]) << "level " << N;
      if (gutter.triangles[i] % 3 != 0) continue;
      on_edge.emplace(numbers[i], i / 3 % 2 == 0);
      used.insert(numbers[i]);
    }
    EXPECT_EQ(on_edge.size(), used.size()) << "each of one side, level " << N;
  }
}

TEST(CornerNormals, LevelsMorph) {
  Gutter gutter;
  const std::uint32_t n = 3 * Gutter::kColumns;
  for (std::uint32_t N = n - 1; N >= 6; --N) {
    LevelMorph before, appearing;
    before.jump(N);
    appearing.jump(N);
    appearing.advance(N, 0);
    appearing.advance(std::min(n, N + 7), 0);
    ASSERT_EQ(appearing.weight(N), 0);
    const std::vector<float> at_level = gutter.sums(before), with_new = gutter.sums(appearing);
    for (std::uint32_t i = 0; i < at_level.size() / 3; ++i) {
      if (gutter.corners.origin(i) >= N) continue;
      for (std::size_t d = 0; d < 3; ++d) EXPECT_NEAR(with_new[3 * i + d], at_level[3 * i + d], 1e-5) << N << " " << i;
    }
  }
}

}  // namespace
}  // namespace eigencast
