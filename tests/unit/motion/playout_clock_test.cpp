// SPDX-License-Identifier: MIT
#include "common/motion/playout_clock.h"

#include <gtest/gtest.h>

#include <random>

#include "common/motion/playout.h"
#include "tests/unit/motion/support.h"

namespace eigencast {
namespace {

constexpr TimeUs kClockInterval = 40 * kMs;
constexpr TimeUs kZero = 7'000'000'000;  // On the sender's clock.

TEST(PlayoutClock, SlewStaysWithinFivePercent) {
  std::mt19937 random(7);
  std::uniform_int_distribution<TimeUs> jitter(0, 60 * kMs);
  PlayoutClock clock;
  TimeUs arrived_us = 0, now_us = 0, media_us = 0, last_us = 0;
  for (int i = 0; i < 500; ++i) {
    // A stall of 300 ms every four seconds, jitter, and a sender's clock that is a thousandth fast.
    const TimeUs stall_us = i % 100 > 90 ? (300 * kMs - (i % 100 - 90) * kClockInterval) : 0;
    arrived_us = std::max(arrived_us, i * kClockInterval + jitter(random) + std::max<TimeUs>(0, stall_us));
    clock.add(kZero + i * (kClockInterval + 40), arrived_us);
    for (now_us = std::max(now_us, arrived_us); now_us < (i + 1) * kClockInterval; now_us += 7 * kMs) {
      const TimeUs before_us = media_us;
      media_us = clock.advance(now_us, clock.full_delay_us());
      if (i < 3) continue;
      EXPECT_FALSE(clock.jumped());
      // Since the turn before, however long that is ago: never faster or slower than 5 %.
      if (last_us > 0 && last_us < now_us) {
        const double pace = static_cast<double>(media_us - before_us) / static_cast<double>(now_us - last_us);
        EXPECT_GE(pace, 0.949);
        EXPECT_LE(pace, 1.051);
      }
      last_us = now_us;
    }
  }
}

TEST(PlayoutClock, FullDelayIsIntervalPlusJitter) {
  PlayoutClock even;
  for (int i = 0; i < 100; ++i) even.add(kZero + i * kClockInterval, i * kClockInterval);
  EXPECT_EQ(even.full_delay_us(), kClockInterval);

  PlayoutClock uneven;
  for (int i = 0; i < 100; ++i) uneven.add(kZero + i * kClockInterval, i * kClockInterval + (i % 10) * 3 * kMs);
  EXPECT_EQ(uneven.full_delay_us(), kClockInterval + 27 * kMs);
}

TEST(PlayoutClock, PauseIsNotAnInterval) {
  PlayoutClock clock;
  clock.add(kZero, 0);
  clock.add(kZero + 800 * kMs, 800 * kMs);
  EXPECT_EQ(clock.full_delay_us(), 0);
  clock.add(kZero + 840 * kMs, 840 * kMs);
  EXPECT_EQ(clock.full_delay_us(), kClockInterval);
}

TEST(PlayoutClock, NewDelayIsReachedBySlew) {
  PlayoutClock clock;
  for (int i = 0; i < 3; ++i) clock.add(kZero + i * kClockInterval, i * kClockInterval);
  TimeUs now_us = 2 * kClockInterval;
  clock.advance(now_us, 0);
  // 100 ms more to hold at 5 %: two seconds.
  for (const TimeUs behind_us : {50 * kMs, 100 * kMs, 100 * kMs}) {
    now_us += 1'000 * kMs;
    EXPECT_EQ(clock.advance(now_us, 100 * kMs), kZero + now_us - behind_us);
  }
}

TEST(PlayoutClock, JumpsBeyondOneSecondOfError) {
  PlayoutClock clock;
  for (int i = 0; i < 10; ++i) clock.add(kZero + i * kClockInterval, i * kClockInterval);
  clock.advance(9 * kClockInterval, kClockInterval);
  const TimeUs later_us = kZero + 3'600'000 * kMs;
  for (int i = 10; i < 12; ++i) clock.add(later_us + i * kClockInterval, i * kClockInterval);
  EXPECT_EQ(clock.advance(11 * kClockInterval, kClockInterval), later_us + 10 * kClockInterval);
  EXPECT_TRUE(clock.jumped());
  clock.advance(11 * kClockInterval + kMs, kClockInterval);
  EXPECT_FALSE(clock.jumped());
}

TEST(Correction, FadesEvenlyWithinItsTime) {
  Correction correction;
  const std::vector<double> error{3, -6};
  correction.add(error, 1'000 * kMs);
  std::vector<double> pose{10, 10};
  correction.apply(pose, 1'000 * kMs);
  EXPECT_EQ(pose, (std::vector<double>{13, 4})) << "what was shown is shown on";
  pose = {10, 10};
  correction.apply(pose, 1'050 * kMs);
  EXPECT_DOUBLE_EQ(pose[0], 12);
  EXPECT_DOUBLE_EQ(pose[1], 6);
  EXPECT_TRUE(correction.active(1'149 * kMs));
  EXPECT_FALSE(correction.active(1'150 * kMs));
  pose = {10, 10};
  correction.apply(pose, 2'000 * kMs);
  EXPECT_EQ(pose, (std::vector<double>{10, 10}));
}

TEST(Correction, SecondErrorAddsToTheRemainder) {
  Correction correction;
  const std::vector<double> first{3}, second{1};
  correction.add(first, 0);
  correction.add(second, 50 * kMs);
  std::vector<double> pose{0};
  correction.apply(pose, 50 * kMs);
  EXPECT_DOUBLE_EQ(pose[0], 2 + 1) << "no jump but that of the new error";
}

}  // namespace
}  // namespace eigencast
