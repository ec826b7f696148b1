// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>
#include <random>

#include "common/reconstruction/reconstruct.h"
#include "tests/unit/reconstruction/random_asset.h"

namespace eigencast {
namespace {

// A strip of triangles that is contracted from its end: vertex i goes to i - 1.
Asset strip(std::uint32_t n) {
  Asset asset;
  asset.vertex_count = asset.rows_ready = n;
  asset.base_count = 3;
  asset.map = {0, 1, 2};
  for (std::uint32_t i = 3; i < n; ++i) asset.map.push_back(i - 1);
  asset.faces.push_back({0, 1, 2});
  asset.death.push_back(0);
  for (std::uint32_t i = 3; i < n; ++i) {
    asset.faces.push_back({i - 2, i - 1, i});
    asset.death.push_back(i);
  }
  asset.face_total = asset.faces_ready = n - 2;
  return asset;
}

TEST(Triangles, UseOnlyVerticesOfTheLevel) {
  const Asset asset = strip(20);
  for (std::uint32_t N = 3; N <= 20; ++N) {
    const auto triangles = triangles_at_level(asset, N);
    ASSERT_EQ(triangles.size(), 3 * (N - 2));
    EXPECT_LT(*std::max_element(triangles.begin(), triangles.end()), N);
  }
}

TEST(Triangles, MissingCornersMapToTheirTarget) {
  Asset asset = strip(6);
  asset.faces[0] = {0, 1, 5};  // The base's face, whose third corner is refined from 2 to 5.
  asset.map[5] = 4;
  EXPECT_EQ(triangles_at_level(asset, 3), (std::vector<std::uint32_t>{0, 1, 2}));
  EXPECT_EQ(triangles_at_level(asset, 5)[2], 4U);
  EXPECT_EQ(triangles_at_level(asset, 6)[2], 5U);
}

TEST(Triangles, IncludeOnlyArrivedFaces) {
  Asset asset = strip(20);
  asset.rows_ready = 10;
  asset.faces_ready = 8;
  for (std::size_t f = 8; f < asset.death.size(); ++f) asset.death[f] = 0;  // Not yet there.
  EXPECT_EQ(triangles_at_level(asset, 10).size(), 24U);
}

TEST(Triangles, PointCloudsHaveNone) {
  EXPECT_TRUE(triangles_at_level(testing::random_asset(10, 2), 7).empty());
}

TEST(Normals, OfASphereEqualItsPositions) {
  constexpr std::uint32_t kAround = 96, kDown = 48;
  std::vector<float> positions;
  std::vector<std::uint32_t> triangles;
  for (std::uint32_t j = 0; j <= kDown; ++j) {
    for (std::uint32_t i = 0; i < kAround; ++i) {
      const double a = 2 * M_PI * i / kAround, b = M_PI * (0.02 + 0.96 * j / kDown);
      positions.push_back(static_cast<float>(std::sin(b) * std::cos(a)));
      positions.push_back(static_cast<float>(std::sin(b) * std::sin(a)));
      positions.push_back(static_cast<float>(std::cos(b)));
    }
  }
  for (std::uint32_t j = 0; j < kDown; ++j) {
    for (std::uint32_t i = 0; i < kAround; ++i) {
      const std::uint32_t right = (i + 1) % kAround, a = j * kAround + i, b = (j + 1) * kAround + i;
      for (const std::uint32_t v : {a, b, j * kAround + right, j * kAround + right, b, (j + 1) * kAround + right}) {
        triangles.push_back(v);
      }
    }
  }
  std::vector<float> normals(positions.size());
  vertex_normals(positions, triangles, normals);
  for (std::size_t i = 0; i < positions.size(); i += 3) {
    const double along = double{normals[i]} * double{positions[i]} + double{normals[i + 1]} * double{positions[i + 1]} +
                         double{normals[i + 2]} * double{positions[i + 2]};
    EXPECT_GT(along, 0.998);
    EXPECT_NEAR(std::hypot(normals[i], normals[i + 1], normals[i + 2]), 1, 1e-6);
  }
}

TEST(Normals, AreWeightedByArea) {
  // Two faces meet at vertex 0: one along z with area 1/2, one along x with area 3/2.
  const std::vector<float> positions{0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 3, 0, 0, 0, 1};
  const std::vector<std::uint32_t> triangles{0, 1, 2, 0, 3, 4};
  std::vector<float> normals(15);
  vertex_normals(positions, triangles, normals);
  EXPECT_NEAR(normals[0], 3 / std::sqrt(10), 1e-6);
  EXPECT_NEAR(normals[2], 1 / std::sqrt(10), 1e-6);
}

TEST(Normals, TinyModelsHaveUnitNormals) {
  const std::vector<float> positions{0, 0, 0, 1e-9F, 0, 0, 0, 1e-9F, 0, 5, 5, 5};
  const std::vector<std::uint32_t> triangles{0, 1, 2};
  std::vector<float> normals(12, 7.0F);
  vertex_normals(positions, triangles, normals);
  EXPECT_FLOAT_EQ(normals[2], 1);
  EXPECT_EQ(normals[9], 0);
  EXPECT_EQ(normals[10], 0);
  EXPECT_EQ(normals[11], 0);
}

TEST(Level, IsTheNearestDrawableOne) {
  Asset asset = strip(1000);
  EXPECT_EQ(level_from_fraction(asset, 1), 1000U);
  EXPECT_EQ(level_from_fraction(asset, 0.2504), 250U);
  EXPECT_EQ(level_from_fraction(asset, 0), 3U);
  EXPECT_EQ(level_from_fraction(asset, -1), 3U);
  EXPECT_EQ(level_from_fraction(asset, 1e300), 1000U);
  EXPECT_EQ(level_from_fraction(asset, std::numeric_limits<double>::quiet_NaN()), 3U);
  asset.rows_ready = 400;
  EXPECT_EQ(level_from_fraction(asset, 1), 400U);
}

/// Six points of the x y plane with two more above it; row 6 splits off 0, then 7 off 6 and 8 off 0.
Asset cloud_with_splats() {
  Asset cloud = testing::random_asset(9, 4);
  cloud.base_count = 6;
  cloud.map = {0, 1, 2, 3, 4, 5, 0, 6, 0};
  for (std::uint32_t i = 0; i < 9; ++i) {
    cloud.splats.frame.push_back({i == 1 ? 2U : 1U, i == 3 ? 4U : 3U});
    cloud.splats.normal.push_back({0.6F, 0, 0.8F});
    cloud.splats.radius.push_back(1.0F + static_cast<float>(i));
    cloud.splats.parent_radius.push_back(i < 6 ? 0.0F : 0.1F * static_cast<float>(i));
  }
  return cloud;
}

TEST(Splats, RadiiShrinkAsRowsSplitOff) {
  const Asset cloud = cloud_with_splats();
  std::vector<float> radii(9);
  splat_radii(cloud, 6, radii);
  EXPECT_EQ(std::vector<float>(radii.begin(), radii.begin() + 6), (std::vector<float>{1, 2, 3, 4, 5, 6}));
  splat_radii(cloud, 7, radii);
  EXPECT_FLOAT_EQ(radii[0], 0.6F);
  EXPECT_EQ(radii[6], 7.0F);
  splat_radii(cloud, 9, radii);
  EXPECT_FLOAT_EQ(radii[0], 0.8F);
  EXPECT_FLOAT_EQ(radii[6], 0.7F);
  EXPECT_EQ(radii[8], 9.0F);
}

TEST(Splats, NormalsFollowRotationAndIgnoreScale) {
  const Asset cloud = cloud_with_splats();
  std::mt19937 random(3);
  std::vector<float> positions, turned;
  for (int i = 0; i < 9; ++i) {
    std::array<float, 3> p{};
    for (float& x : p) x = static_cast<float>(random()) / 4294967296.0F;
    positions.insert(positions.end(), p.begin(), p.end());
    turned.insert(turned.end(), {-3 * p[1] + 1, 3 * p[0], 3 * p[2] - 7});  // a quarter turn about z, thrice the size
  }
  std::vector<float> before(27), after(27);
  splat_normals(cloud, positions, before);
  splat_normals(cloud, turned, after);
  for (std::size_t i = 0; i < 27; i += 3) {
    EXPECT_NEAR(std::hypot(before[i], before[i + 1], before[i + 2]), 1, 1e-5);
    EXPECT_NEAR(after[i], -before[i + 1], 1e-4);
    EXPECT_NEAR(after[i + 1], before[i], 1e-4);
    EXPECT_NEAR(after[i + 2], before[i + 2], 1e-4);
  }
}

TEST(Splats, AbsentSplatsGiveZeroNormalsAndRadii) {
  const Asset cloud = testing::random_asset(9, 4);
  std::vector<float> some(27, 1.0F), radii(9, 1.0F);
  splat_normals(cloud, std::vector<float>(27, 1.0F), some);
  splat_radii(cloud, 9, radii);
  EXPECT_EQ(some, std::vector<float>(27, 0.0F));
  EXPECT_EQ(radii, std::vector<float>(9, 0.0F));
}

}  // namespace
}  // namespace eigencast
