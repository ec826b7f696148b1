// SPDX-License-Identifier: MIT
#include "common/surface/checks/surface_distance.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "common/surface/shapes/shapes.h"

namespace eigencast {
namespace {

std::vector<Vec3> random_points(std::size_t count, double size) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> uniform(-size, size);
  std::vector<Vec3> points(count);
  for (Vec3& p : points) p = {uniform(random), uniform(random), uniform(random)};
  return points;
}

TEST(SurfaceDistance, ToABoxFollowsTheFormula) {
  const Surface box = make_box(5, 3, 4, {2, 4, 6});
  const SurfaceDistance distance(box.positions, box.faces);
  const Vec3 half = {1, 2, 3};
  for (const Vec3& p : random_points(500, 5)) {
    double outside = 0, inside = 1e9;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const double beyond = std::abs(p[axis]) - half[axis];
      outside += std::pow(std::max(beyond, 0.0), 2);
      inside = std::min(inside, -beyond);
    }
    const double expected = outside > 0 ? std::sqrt(outside) : inside;
    EXPECT_NEAR(std::sqrt(distance.squared(p)), expected, 1e-12);
  }
}

TEST(SurfaceDistance, ToPointsIsTheNearest) {
  const std::vector<Vec3> cloud = random_points(300, 1);
  const SurfaceDistance distance(cloud, {});
  for (const Vec3& p : random_points(100, 2)) {
    double nearest = 1e9;
    for (const Vec3& q : cloud) nearest = std::min(nearest, squared_distance(p, q));
    EXPECT_EQ(distance.squared(p), nearest);
  }
}

TEST(SurfaceDistance, FollowsAPose) {
  const Surface box = make_box(4, 4, 4, {1, 1, 1});
  SurfaceDistance moved(box.positions, box.faces);
  std::vector<Vec3> pose = box.positions;
  for (Vec3& p : pose) p = {3 + 2 * p[1], -p[0], p[2] + p[0] * p[1]};
  moved.move_to(pose);
  const SurfaceDistance fresh(pose, box.faces);
  for (const Vec3& p : random_points(200, 5)) EXPECT_DOUBLE_EQ(moved.squared(p), fresh.squared(p));
}

TEST(SurfaceDistance, TrianglesWithoutAreaAreSegmentsAndPoints) {
  const std::vector<Vec3> positions = {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {5, 5, 5}};
  const std::vector<Face> faces = {{0, 1, 2}, {3, 3, 3}};
  const SurfaceDistance distance(positions, faces);
  EXPECT_DOUBLE_EQ(distance.squared({1.5, 2, 0}), 4);
  EXPECT_DOUBLE_EQ(distance.squared({5, 5, 6}), 1);
}

TEST(SurfaceDistance, HausdorffSideDoesNotDependOnBounds) {
  const Surface box = make_box(6, 6, 6, {1, 1, 1});
  const SurfaceDistance distance(box.positions, box.faces);
  std::vector<Vec3> off = box.positions;
  std::vector<double> bounds;
  for (std::size_t i = 0; i < off.size(); ++i) {
    off[i][i % 3] += 1e-3 * static_cast<double>(i % 17);
    bounds.push_back(squared_distance(off[i], box.positions[i]));
  }
  const double with = farthest_squared(off, distance, bounds), without = farthest_squared(off, distance);
  EXPECT_GT(with, 0);
  EXPECT_EQ(with, without);
  EXPECT_EQ(farthest_squared(off, distance, bounds, 9), 9);
  EXPECT_EQ(farthest_squared(box.positions, distance), 0);
}

}  // namespace
}  // namespace eigencast
