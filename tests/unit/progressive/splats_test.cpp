// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <numbers>
#include <random>
#include <utility>

#include "common/progressive/point_normals.h"
#include "common/progressive/splats.h"
#include "common/surface/formats/read.h"
#include "common/surface/shapes/shapes.h"
#include "common/surface/vector.h"
#include "tests/support/paths.h"

namespace eigencast {
namespace {

std::vector<Vec3> normals_of_mesh(const Surface& mesh) {
  std::vector<Vec3> normals(mesh.positions.size());
  for (const Face& f : mesh.faces) {
    const Vec3 n = cross(mesh.positions[f[1]] - mesh.positions[f[0]], mesh.positions[f[2]] - mesh.positions[f[0]]);
    for (const std::uint32_t corner : f) {
      for (std::size_t d = 0; d < 3; ++d) normals[corner][d] += n[d];
    }
  }
  return normals;
}

/// The share of vertices whose normals point to the mesh's side.
double share_outwards(const Surface& mesh, std::span<const Vec3> normals) {
  const auto truth = normals_of_mesh(mesh);
  std::size_t right = 0;
  for (std::size_t i = 0; i < truth.size(); ++i) right += dot(truth[i], normals[i]) > 0;
  return static_cast<double>(right) / static_cast<double>(truth.size());
}

TEST(PointNormals, PointOutwardsOnSphereTorusAndHeart) {
  for (const Surface& shape : {make_icosphere(4), make_torus(80, 40, 1, 0.4), make_heart(20)}) {
    EXPECT_EQ(share_outwards(shape, oriented_normals(shape.positions)), 1.0);
  }
}

TEST(PointNormals, OnASphereEqualItsPoints) {
  const Surface sphere = make_icosphere(5);
  const auto normals = oriented_normals(sphere.positions);
  for (std::size_t i = 0; i < normals.size(); ++i) EXPECT_GT(dot(normals[i], sphere.positions[i]), 0.999);
}

// The two sides of the box are nearer to each other than their own points are: what carries signs must not take them
// for one.
TEST(PointNormals, TellTheSidesOfAThinSheetApart) {
  const Surface sheet = make_box(60, 60, 1, {1, 1, 0.03});
  const auto normals = oriented_normals(sheet.positions);
  std::size_t wrong = 0, inner = 0;
  for (std::size_t i = 0; i < normals.size(); ++i) {
    const Vec3& p = sheet.positions[i];
    if (std::abs(p[0]) > 0.45 || std::abs(p[1]) > 0.45) continue;
    ++inner;
    wrong += normals[i][2] * p[2] <= 0;
  }
  EXPECT_GT(inner, 5000u);
  EXPECT_EQ(wrong, 0u);
}

TEST(PointNormals, PiecesAreOrientedOneByOne) {
  Surface shape = make_icosphere(3);
  const std::size_t n = shape.positions.size();
  for (std::size_t i = 0; i < n; ++i) {
    const Vec3 p = shape.positions[i];
    shape.positions.push_back({p[0] + 10, p[1], p[2]});
  }
  shape.positions.push_back(shape.positions[5]);
  const auto normals = oriented_normals(shape.positions);
  for (std::size_t i = 0; i < n; ++i) {
    EXPECT_GT(dot(normals[i], shape.positions[i]), 0.9);
    EXPECT_GT(dot(normals[n + i], shape.positions[i]), 0.9);
  }
  EXPECT_EQ(normals.back(), normals[5]);
}

TEST(PointNormals, AreUnitAndFiniteForAnyPoints) {
  std::mt19937 random(5);
  const auto uniform = [&] { return static_cast<double>(random()) / 4294967296.0; };
  std::vector<std::vector<Vec3>> clouds = {
      {}, {{1, 2, 3}}, {{0, 0, 0}, {1, 0, 0}}, std::vector<Vec3>(40, Vec3{1, 1, 1})};
  clouds.emplace_back();
  for (int i = 0; i < 50; ++i) clouds.back().push_back({i * 0.1, 0, 0});  // a line
  clouds.emplace_back();
  for (int i = 0; i < 500; ++i) clouds.back().push_back({uniform(), uniform(), uniform()});  // a volume
  for (const auto& cloud : clouds) {
    const auto normals = oriented_normals(cloud);
    ASSERT_EQ(normals.size(), cloud.size());
    for (const Vec3& n : normals) EXPECT_NEAR(length(n), 1, 1e-9);
  }
}

struct Cloud {
  explicit Cloud(Surface mesh) : surface{std::move(mesh.positions), {}} {
    order = build_prefix_order(surface).value();
    const std::vector<Vec3> all = oriented_normals(surface.positions);
    splats = build_splats(surface.positions, all, order);
    for (const std::uint32_t i : order.order) {
      rows.push_back(surface.positions[i]);
      normals.push_back(all[i]);
    }
  }
  std::vector<double> radii(std::uint32_t N) const {
    std::vector<double> at_level(splats.radius.begin(), splats.radius.begin() + N);
    for (std::uint32_t i = order.base_count; i < N; ++i) at_level[order.map[i]] = splats.parent_radius[i];
    return at_level;
  }
  Surface surface;
  PrefixOrder order;
  PointSplats splats;
  std::vector<Vec3> rows, normals;
};

TEST(Splats, FramesExistAtEveryLevelAndGiveNormals) {
  const Cloud cloud(make_icosphere(4));
  for (std::uint32_t i = 0; i < cloud.rows.size(); ++i) {
    const auto [a, b] = cloud.splats.frame[i];
    ASSERT_LT(std::max(a, b), std::max(i + 1, cloud.order.base_count));
    ASSERT_TRUE(a != b && a != i && b != i);
    const auto axes = frame_from_points(cloud.rows[i], cloud.rows[a], cloud.rows[b]);
    double along = 0;
    for (std::size_t k = 0; k < 3; ++k) along += double{cloud.splats.normal[i][k]} * dot(axes[k], cloud.rows[i]);
    EXPECT_GT(along, 0.99) << i;
    EXPECT_GT(cloud.splats.normal[i][2], 0) << i;
  }
}

TEST(Splats, DiscsOfEveryLevelCoverTheirPoints) {
  const Cloud cloud(make_torus(60, 30, 1, 0.4));
  const auto n = static_cast<std::uint32_t>(cloud.rows.size());
  for (const std::uint32_t N : {cloud.order.base_count, n / 20, n / 3, n - 1, n}) {
    const std::vector<double> radii = cloud.radii(N);
    for (std::uint32_t i = 0; i < n; ++i) {
      const std::uint32_t corner = prefix_corner(cloud.order.map, i, N);
      const Vec3 e = cloud.rows[i] - cloud.rows[corner];
      const Vec3 &here = cloud.normals[corner], &there = cloud.normals[i];
      if (dot(here, there) < 0.31 || length(e) > 0.4) continue;  // on another side of the tube, or along it
      EXPECT_LE(length(cross(e, here)), radii[corner] * 1.000001) << i << " at " << N;
    }
  }
}

// A ring as thin as a leg: at a level where some six points go round it, and where there are fewer than it is long.
TEST(Splats, DiscsOfALimbAreNotWiderThanItIs) {
  const Cloud cloud(make_torus(400, 16, 1, 0.04));
  for (const auto& [N, mean] : {std::pair(900U, 1.0), std::pair(150U, 1.6), std::pair(40U, 1.7)}) {
    double worst = 0, sum = 0;
    for (const double radius : cloud.radii(N)) {
      worst = std::max(worst, radius / 0.04);
      sum += radius / 0.04;
    }
    EXPECT_LE(worst, 2.1) << N;
    EXPECT_LE(sum / N, mean) << N;
  }
}

// A ring as thin as a tusk round a large body, which has most of the points of each level.
TEST(Splats, DiscsCoverThinLimbsOfLargeBodies) {
  Surface both = make_icosphere(5), ring = make_torus(400, 8, 1, 0.02);
  both.faces.clear();
  for (Vec3& p : both.positions) p = 0.7 * p;
  both.positions.insert(both.positions.end(), ring.positions.begin(), ring.positions.end());
  const Cloud cloud(both);
  for (const auto& [share, least] : {std::pair(0.02, 0.6), std::pair(0.03, 0.7), std::pair(0.05, 0.8)}) {
    const auto N = static_cast<std::uint32_t>(share * static_cast<double>(cloud.rows.size()));
    const std::vector<double> radii = cloud.radii(N);
    constexpr int kPlaces = 1000;
    int covered = 0;
    for (int k = 0; k < kPlaces; ++k) {
      const double at = 2 * std::numbers::pi * k / kPlaces;
      const Vec3 place{std::cos(at), 0, -std::sin(at)};
      for (std::uint32_t i = 0; i < N; ++i) {
        if (length(cloud.rows[i]) < 0.9 || length(cloud.rows[i] - place) > radii[i]) continue;
        ++covered;
        break;
      }
    }
    EXPECT_GE(covered, least * kPlaces) << N;
  }
}

// A plate as thin as an ear. Some of each disc at its rim is over it, or there would be holes along it.
TEST(Splats, DiscsAtARimReachLittleBeyondIt) {
  const Cloud cloud(make_box(80, 80, 1, {1, 1, 0.01}));
  for (const double share : {0.02, 0.03, 0.05}) {
    const auto N = static_cast<std::uint32_t>(share * static_cast<double>(cloud.rows.size()));
    const std::vector<double> radii = cloud.radii(N);
    double sum = 0, worst = 0;
    int at_rim = 0;
    for (std::uint32_t i = 0; i < N; ++i) {
      if (std::abs(cloud.normals[i][2]) < 0.9) continue;  // of the rim itself
      const double beyond = std::max(std::abs(cloud.rows[i][0]), std::abs(cloud.rows[i][1])) + radii[i] - 0.5;
      if (beyond <= 0) continue;
      ++at_rim, sum += beyond, worst = std::max(worst, beyond);
    }
    const double apart = std::sqrt(2.0 / N);  // on two sides
    EXPECT_LE(worst, 0.68 * apart) << N;
    EXPECT_LE(sum / at_rim, 0.33 * apart) << N;
  }
}

TEST(Splats, FewOrCoincidentPointsAreStable) {
  for (const std::vector<Vec3>& points :
       {std::vector<Vec3>{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, std::vector<Vec3>(12, Vec3{1, 2, 3})}) {
    const Cloud cloud(Surface{points, {}});
    for (std::uint32_t i = 0; i < points.size(); ++i) {
      const auto& n = cloud.splats.normal[i];
      EXPECT_NEAR(std::hypot(n[0], n[1], n[2]), 1, 1e-6);
      EXPECT_GE(cloud.splats.radius[i], 0);
    }
  }
}

// Not all: ears and tusks are thinner than their points lie apart, and a mouth has an inside.
TEST(PointNormals, PointOutwardsOnNearlyAllPointsOfAnimals) {
  for (const auto& entry : std::filesystem::directory_iterator(data_dir() / "animations")) {
    const auto mesh = read_surface((entry.path() / "rest.obj").string());
    ASSERT_TRUE(mesh) << mesh.error().message;
    EXPECT_GT(share_outwards(*mesh, oriented_normals(mesh->positions)), 0.955) << entry.path();
  }
}

}  // namespace
}  // namespace eigencast
