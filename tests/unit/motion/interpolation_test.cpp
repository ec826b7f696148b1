// SPDX-License-Identifier: MIT
#include "common/motion/interpolation.h"

#include <gtest/gtest.h>

#include <limits>

namespace eigencast {
namespace {

const std::vector<double> kA{0, 1, -4}, kB{3, 1, 8};

TEST(Interpolation, MeetsBothEndsAndTheMiddle) {
  EXPECT_EQ(interpolate(kA, kB, 0), kA);
  EXPECT_EQ(interpolate(kA, kB, 1), kB);
  EXPECT_EQ(interpolate(kA, kB, 0.5), (std::vector<double>{1.5, 1, 2}));
}

TEST(Interpolation, StepComesFromTheTimes) {
  const TimedPose a{1000, kA}, b{4000, kB};
  const TimedPose third = interpolate(a, b, 2000);
  EXPECT_EQ(third.time_us, 2000);
  EXPECT_DOUBLE_EQ(third.coefficients[0], 1);
  EXPECT_DOUBLE_EQ(third.coefficients[2], 0);
}

TEST(Interpolation, TimesBeyondTheKeysAreHeld) {
  const TimedPose a{1000, kA}, b{4000, kB};
  for (const TimeUs t : {std::numeric_limits<TimeUs>::min(), TimeUs{999}, TimeUs{1000}}) {
    EXPECT_EQ(interpolate(a, b, t).time_us, 1000);
    EXPECT_EQ(interpolate(a, b, t).coefficients, kA);
  }
  EXPECT_EQ(interpolate(a, b, std::numeric_limits<TimeUs>::max()).time_us, 4000);
  EXPECT_EQ(interpolate(a, b, 4001).coefficients, kB);
}

TEST(Estimation, IsExactOnUniformMotion) {
  EXPECT_EQ(estimate(kA, kB, 0), kB);
  EXPECT_EQ(estimate(kA, kB, 1), (std::vector<double>{6, 1, 20}));
  // Estimating by h and interpolating back by 1 / (1 + h) gives the newer key.
  const auto ahead = estimate(kA, kB, 0.25);
  const auto back = interpolate(kA, ahead, 0.8);
  for (std::size_t i = 0; i < kB.size(); ++i) EXPECT_NEAR(back[i], kB[i], 1e-14);
}

TEST(Estimation, IsHeldAtTheLimit) {
  const TimedPose a{1000, kA}, b{4000, kB};
  EXPECT_EQ(estimate(a, b, 4000, 3000).coefficients, kB);
  const TimedPose limit = estimate(a, b, 7000, 3000);
  EXPECT_EQ(limit.time_us, 7000);
  EXPECT_EQ(limit.coefficients, (std::vector<double>{6, 1, 20}));
  const TimedPose later = estimate(a, b, std::numeric_limits<TimeUs>::max(), 3000);
  EXPECT_EQ(later.time_us, 7000);
  EXPECT_EQ(later.coefficients, limit.coefficients);
}

}  // namespace
}  // namespace eigencast
