// SPDX-License-Identifier: MIT
#include "common/spectral/kg_error.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

namespace eigencast {
namespace {

TEST(KgError, IsZeroForTruthAndHundredForMean) {
  const std::vector<Vec3> truth = {{1, 0, 0}, {-1, 2, 0}, {0, 1, 4}, {0, 1, 0}};
  KgError same;
  same.add_frame(truth, truth);
  EXPECT_EQ(same.percent(), 0);
  KgError mean;
  mean.add_frame(truth, std::vector<Vec3>(4, Vec3{0, 1, 1}));
  EXPECT_NEAR(mean.percent(), 100, 1e-12);
}

TEST(KgError, SumsOverFramesBeforeItDivides) {
  const std::vector<Vec3> truth = {{1, 0, 0}, {-1, 0, 0}};      // 2 about its mean
  const std::vector<Vec3> moved = {{101, 50, 0}, {99, 50, 0}};  // the same elsewhere
  const std::vector<Vec3> off = {{1.1, 0, 0}, {-1, 0, 0}};      // 0.01 off
  KgError error;
  error.add_frame(truth, off);
  error.add_frame(moved, moved);
  EXPECT_NEAR(error.percent(), 100 * std::sqrt(0.01 / 4), 1e-12);
}

TEST(KgError, IsInfiniteForAConstantTruth) {
  const std::vector<Vec3> point(5, Vec3{1, 1, 1});
  KgError error;
  EXPECT_EQ(error.percent(), 0);
  error.add_frame(point, std::vector<Vec3>(5, Vec3{0, 0, 0}));
  EXPECT_TRUE(std::isinf(error.percent()));
}

}  // namespace
}  // namespace eigencast
