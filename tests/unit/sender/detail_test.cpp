// SPDX-License-Identifier: MIT
#include "sender/detail.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "common/surface/shapes.h"
#include "common/surface/surface_distance.h"

namespace eigencast {
namespace {

/// A smooth torus and a bumpy one over it.
class DetailOfBumps : public ::testing::Test {
 protected:
  DetailOfBumps() {
    for (std::size_t i = 0; i < rest_.size(); ++i) {
      const double bump = 0.02 * std::sin(40.0 * static_cast<double>(i));
      for (std::size_t axis = 0; axis < 3; ++axis) rest_[i][axis] += axis == i % 3 ? 2 * bump : bump;
    }
  }
  /// A rotation by 2 rad round (1, 1, 1) and a shift.
  static Vec3 moved(const Vec3& p) {
    const double c = std::cos(2.0), s = std::sin(2.0) / std::sqrt(3.0), k = (1 - c) / 3 * (p[0] + p[1] + p[2]);
    return {c * p[0] + s * (p[2] - p[1]) + k + 5, c * p[1] + s * (p[0] - p[2]) + k,
            c * p[2] + s * (p[1] - p[0]) + k - 1};
  }
  double worst(const std::vector<Vec3>& a, const std::vector<Vec3>& b) const {
    double squared = 0;
    for (std::size_t i = 0; i < a.size(); ++i) squared = std::max(squared, squared_distance(a[i], b[i]));
    return std::sqrt(squared);
  }
  const Surface base_ = make_torus(40, 20, 1, 0.4);
  std::vector<Vec3> rest_ = base_.positions;
};

TEST_F(DetailOfBumps, FramesBringBackTheRestPoseAndCarryItRigidly) {
  for (const std::vector<Face>& faces : {base_.faces, std::vector<Face>()}) {
    const Detail detail(DetailKind::kFrames, rest_, base_.positions, faces);
    std::vector<Vec3> pose = base_.positions, truth = rest_;
    detail.add_to(pose);
    EXPECT_LT(worst(pose, rest_), 1e-12);
    std::vector<Vec3> turned = base_.positions;
    std::transform(turned.begin(), turned.end(), turned.begin(), moved);
    std::transform(truth.begin(), truth.end(), truth.begin(), moved);
    detail.add_to(turned);
    EXPECT_LT(worst(turned, truth), 1e-12);
  }
}

TEST_F(DetailOfBumps, NormalsCarryOnlyWhatLiesAlongThemButRigidlyToo) {
  const Detail detail(DetailKind::kNormal, rest_, base_.positions, base_.faces);
  std::vector<Vec3> pose = base_.positions;
  detail.add_to(pose);
  const double lost = worst(pose, rest_);
  EXPECT_GT(lost, 0.005);
  EXPECT_LT(lost, worst(base_.positions, rest_));
  std::vector<Vec3> turned = base_.positions, expected = pose;
  std::transform(turned.begin(), turned.end(), turned.begin(), moved);
  std::transform(expected.begin(), expected.end(), expected.begin(), moved);
  detail.add_to(turned);
  EXPECT_LT(worst(turned, expected), 1e-12);
}

TEST_F(DetailOfBumps, HeightsAreDistancesAlongTheNormal) {
  std::vector<Vec3> grown = base_.positions;  // along the torus' own normals
  for (Vec3& p : grown) {
    const double ring = std::hypot(p[0], p[2]), x = p[0] - p[0] / ring, z = p[2] - p[2] / ring;
    p = {p[0] + 0.1 * x / 0.4, p[1] + 0.1 * p[1] / 0.4, p[2] + 0.1 * z / 0.4};
  }
  for (const double height : Detail(DetailKind::kNormal, grown, base_.positions, base_.faces).heights())
    EXPECT_NEAR(height, 0.1, 2e-3);
}

TEST_F(DetailOfBumps, NoneAddsNothing) {
  std::vector<Vec3> pose = base_.positions;
  Detail(DetailKind::kNone, rest_, base_.positions, base_.faces).add_to(pose);
  EXPECT_EQ(worst(pose, base_.positions), 0);
}

}  // namespace
}  // namespace eigencast
