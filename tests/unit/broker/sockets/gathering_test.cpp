// SPDX-License-Identifier: MIT
#include "broker/sockets/turn.h"

#include <gtest/gtest.h>

namespace eigencast::broker {
namespace {

/// The answer after `seconds` of poses at an even rate.
bool waits_at(Gathering& gathering, TimeUs& now_us, int per_second, int seconds) {
  bool waits = false;
  for (int i = 0; i < per_second * seconds; ++i) waits = gathering.waits(1, now_us += 1'000'000 / per_second);
  return waits;
}

TEST(GatheringTest, WaitsUnderLoadWithoutOscillating) {
  Gathering gathering({16'000, 20'000});
  TimeUs now_us = 0;
  EXPECT_FALSE(waits_at(gathering, now_us, 18'000, 1));
  EXPECT_TRUE(waits_at(gathering, now_us, 25'000, 1));
  EXPECT_TRUE(waits_at(gathering, now_us, 12'000, 1)) << "within the band between on and off";
  EXPECT_FALSE(waits_at(gathering, now_us, 8'000, 1));
}

TEST(GatheringTest, NextTickIsWithinOneTick) {
  const Gathering gathering({16'000, 0});
  for (TimeUs now_us = 0; now_us < 100'000; now_us += 777) {
    EXPECT_GT(gathering.next_tick_us(now_us), now_us);
    EXPECT_LE(gathering.next_tick_us(now_us), now_us + 16'000);
  }
}

TEST(GatheringTest, CanBeTurnedOff) {
  Gathering gathering({0, 0});
  TimeUs now_us = 0;
  EXPECT_FALSE(waits_at(gathering, now_us, 100'000, 1));
}

}  // namespace
}  // namespace eigencast::broker
