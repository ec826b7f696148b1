// SPDX-License-Identifier: MIT
#include "common/surface/checks/edge_difference.h"

#include <gtest/gtest.h>

#include <cmath>

#include "common/surface/shapes/shapes.h"

namespace eigencast {
namespace {

constexpr double kRounding = 1e-7;  // the root of a difference of squares

class EdgeDifferenceOfABox : public ::testing::Test {
 protected:
  /// The error of six frames that drift along x, rebuilt as `rebuild` says.
  template <typename Rebuild>
  EdgeDifferenceError error_of(Rebuild&& rebuild) const {
    EdgeDifference difference(box_.vertex_count(), box_.faces, bounding_box(box_.positions).diagonal());
    for (int frame = 0; frame < 6; ++frame) {
      std::vector<Vec3> truth = box_.positions;
      for (Vec3& p : truth) p[0] += 0.1 * frame;
      std::vector<Vec3> rebuilt = truth;
      for (std::size_t i = 0; i < rebuilt.size(); ++i) rebuild(frame, i, rebuilt[i]);
      difference.add(truth, rebuilt);
    }
    return difference.result();
  }
  const Surface box_ = make_box(4, 4, 4, {1, 1, 1});
};

TEST_F(EdgeDifferenceOfABox, IsZeroForTheTruthAndItsTranslation) {
  for (const double shift : {0.0, 3.0}) {
    const EdgeDifferenceError error = error_of([&](int, std::size_t, Vec3& p) { p[1] += shift; });
    EXPECT_NEAR(error.spatial, 0, kRounding);
    EXPECT_NEAR(error.temporal, 0, kRounding);
  }
}

TEST_F(EdgeDifferenceOfABox, EvenStretchingIsZero) {
  const EdgeDifferenceError error = error_of([](int frame, std::size_t, Vec3& p) {
    p = {1.1 * (p[0] - 0.1 * frame) + 0.1 * frame, 1.1 * p[1], 1.1 * p[2]};
  });
  EXPECT_NEAR(error.spatial, 0, kRounding);
  EXPECT_NEAR(error.temporal, 0, kRounding);
}

TEST_F(EdgeDifferenceOfABox, BumpsAreSpatialShakesAlsoTemporal) {
  const EdgeDifferenceError bump = error_of([](int, std::size_t i, Vec3& p) { p[1] += i == 5 ? 0.1 : 0; });
  EXPECT_GT(bump.spatial, 1e-3);
  EXPECT_NEAR(bump.temporal, 0, kRounding);
  const EdgeDifferenceError shake =
      error_of([](int frame, std::size_t, Vec3& p) { p[0] += frame % 3 == 0 ? 0.01 : 0; });
  EXPECT_NEAR(shake.spatial, 0, kRounding);
  EXPECT_GT(shake.temporal, 1e-3);
  EXPECT_DOUBLE_EQ(shake.combined(), std::hypot(shake.spatial, EdgeDifference::kTemporalWeight * shake.temporal));
}

TEST(EdgeDifference, TwoEdgesGiveTheirWeightedDeviation) {
  // A path of lengths 1 and 3, of which the second comes out 10 % long: differences 0 and 0.1, weights 1 and 3.
  const std::vector<Vec3> truth = {{0, 0, 0}, {1, 0, 0}, {4, 0, 0}};
  const std::vector<Vec3> rebuilt = {{0, 0, 0}, {1, 0, 0}, {4.3, 0, 0}};
  const std::vector<Face> faces = {{0, 1, 1}, {1, 2, 2}};
  EdgeDifference difference(3, faces, 1);
  difference.add(truth, rebuilt);
  const double mean = 0.3 / 4, deviation = std::sqrt(3 * 0.01 / 4 - mean * mean);
  EXPECT_NEAR(difference.result().spatial, deviation / 3,
              1e-12);  // The ends have one edge each, which deviates from nothing.
}

TEST(EdgeDifference, PointCloudsGiveZero) {
  const std::vector<Vec3> points(4);
  EdgeDifference difference(4, {}, 1);
  difference.add(points, points);
  EXPECT_EQ(difference.result().combined(), 0);
}

}  // namespace
}  // namespace eigencast
