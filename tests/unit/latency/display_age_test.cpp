// SPDX-License-Identifier: MIT
#include "tools/latency/over_time.h"

#include <gtest/gtest.h>

namespace eigencast::latency {
namespace {

TEST(DisplayAge, GrowsUntilTheNextPose) {
  DisplayAge age;
  age.show(1'000'000, 1'010'000);  // 10 ms old when it appears,
  age.show(1'100'000, 1'110'000);  // and 110 ms when the next one replaces it.
  EXPECT_EQ(age.ages_us().count(), 100u);
  EXPECT_EQ(age.ages_us().min(), 11'000);
  EXPECT_EQ(age.ages_us().max(), 110'000);
  EXPECT_NEAR(age.ages_us().mean(), 60'500, 1e-9);
}

TEST(DisplayAge, SamplesAreEvenInTime) {
  DisplayAge age;
  age.show(0, 500);
  age.show(100, 600);  // Between two looks: nobody saw the first.
  age.show(200, 10'250);
  age.show(300, 10'750);
  EXPECT_EQ(age.ages_us().count(), 10u);
  EXPECT_EQ(age.ages_us().min(), 900);
}

}  // namespace
}  // namespace eigencast::latency
