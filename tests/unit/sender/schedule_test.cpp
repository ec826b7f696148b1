// SPDX-License-Identifier: MIT
#include "sender/pose_stream.h"

#include <gtest/gtest.h>

namespace eigencast {
namespace {

TEST(Schedule, DeadlinesDoNotDrift) {
  Schedule schedule({.rate_hz = 30, .clip_rate_hz = 30, .frames = 48}, 1000);
  TimeUs now = 1000;
  for (int tick = 0; tick < 100'000; ++tick) {
    const auto next = schedule.next(now);
    ASSERT_TRUE(next);
    EXPECT_NEAR(static_cast<double>(next->due_us), 1000 + tick * 1e6 / 30, 0.51);
    EXPECT_EQ(next->frame, static_cast<std::size_t>(tick % 48));
    now = next->due_us + 500;
  }
  EXPECT_EQ(schedule.skipped(), 0u);
}

TEST(Schedule, LateTicksAreSkippedAndCounted) {
  Schedule schedule({.rate_hz = 10, .clip_rate_hz = 10, .frames = 1000}, 0);
  EXPECT_EQ(schedule.next(0)->frame, 0u);
  const auto after_a_second = schedule.next(1'050'000);
  EXPECT_EQ(after_a_second->frame, 10u);
  EXPECT_EQ(after_a_second->due_us, 1'000'000);
  EXPECT_EQ(schedule.skipped(), 9u);
  EXPECT_EQ(schedule.next(1'060'000)->due_us, 1'100'000);
}

TEST(Schedule, SpeedAndRatesChooseTheFrame) {
  Schedule half_rate({.rate_hz = 15, .clip_rate_hz = 30, .frames = 100}, 0);
  Schedule twice_as_fast({.rate_hz = 30, .clip_rate_hz = 30, .speed = 2, .frames = 100}, 0);
  Schedule slow({.rate_hz = 30, .clip_rate_hz = 30, .speed = 0.5, .frames = 100}, 0);
  for (std::size_t tick = 0; tick < 40; ++tick) {
    EXPECT_EQ(half_rate.next(0)->frame, 2 * tick);
    EXPECT_EQ(twice_as_fast.next(0)->frame, 2 * tick);
    EXPECT_EQ(slow.next(0)->frame, tick / 2);
  }
}

TEST(Schedule, EndsWithTheClipWithoutLoop) {
  Schedule once({.frames = 3, .loop = false}, 0);
  for (int tick = 0; tick < 3; ++tick) EXPECT_TRUE(once.next(0));
  EXPECT_FALSE(once.next(0));
  Schedule loop({.frames = 3, .loop = true, .max_ticks = 7}, 0);
  for (std::size_t tick = 0; tick < 7; ++tick) EXPECT_EQ(loop.next(0)->frame, tick % 3);
  EXPECT_FALSE(loop.next(0));
}

}  // namespace
}  // namespace eigencast
