// SPDX-License-Identifier: MIT
#include "common/net/clock_offset.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <random>

namespace eigencast {
namespace {

TEST(ClockOffset, IsUnknownAtFirstAndAfterReset) {
  ClockOffset offset;
  EXPECT_FALSE(offset.estimate());
  offset.add(0, 10, 20);
  EXPECT_TRUE(offset.estimate());
  offset.reset();
  EXPECT_FALSE(offset.estimate());
}

TEST(ClockOffset, IsExactOnASymmetricPath) {
  ClockOffset offset;
  offset.add(1000, 5'001'050, 1100);
  EXPECT_EQ(offset.estimate()->offset_us, 5'000'000);
  EXPECT_EQ(offset.estimate()->rtt_us, 100);
  EXPECT_EQ(offset.estimate()->error_us, 50);
}

TEST(ClockOffset, IgnoresSamplesThatEndBeforeTheyBegan) {
  ClockOffset offset;
  offset.add(100, 0, 99);
  EXPECT_FALSE(offset.estimate());
}

TEST(ClockOffset, TruthLiesWithinTheStatedError) {
  std::minstd_rand random(7);
  std::uniform_int_distribution<TimeUs> delay(0, 30'000);
  for (const TimeUs truth : {TimeUs{0}, TimeUs{-7'654'321}, TimeUs{1'000'000'000'007}}) {
    ClockOffset offset;
    for (int i = 0; i < 500; ++i) {
      const TimeUs sent = i * 250'000, there = delay(random), back = delay(random);
      offset.add(sent, sent + there + truth, sent + there + back);
      const auto e = *offset.estimate();
      EXPECT_LE(std::abs(e.offset_us - truth), e.error_us);
      EXPECT_LE(e.error_us, (e.rtt_us + 1) / 2);
    }
  }
}

TEST(ClockOffset, FollowsAClockThatStepped) {
  ClockOffset offset;
  offset.add(0, 5, 10);  // The best sample ever, but of a past that no longer holds.
  for (int i = 1; i <= 32; ++i) offset.add(i * 1000, i * 1000 + 9'000'050, i * 1000 + 100);
  EXPECT_EQ(offset.estimate()->offset_us, 9'000'000);
}

}  // namespace
}  // namespace eigencast
