// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include "broker/connections/rewind.h"

namespace eigencast::broker {
namespace {

constexpr TimeUs kReplayAt = 1'800'000'000'000'000, kReplayNow = 5'000'000, kReplayMs = 1'000;

Passage replayed(double speed, std::vector<TimeUs> ats, bool begins, bool ends = false) {
  Passage made;
  for (const TimeUs at_us : ats) made.poses.push_back({kReplayAt + at_us, std::make_shared<const KeyRecord>()});
  if (begins) made.begins = Passage::Beginning{{}, {kReplayAt + ats.front(), 0, speed}};
  made.ends = ends;
  return made;
}

TEST(Replay, PosesAreDueAtTheirSpeed) {
  for (const double speed : {0.5, 1.0, 4.0}) {
    Replay replay;
    replay.add(replayed(speed, {0}, true), true);
    ASSERT_TRUE(replay.pop_due(kReplayNow)->begins) << "the first picture waits for nothing";
    replay.add(replayed(speed, {100 * kReplayMs, 200 * kReplayMs}, false), false);
    const auto first_us = kReplayNow + static_cast<TimeUs>(100 * kReplayMs / speed);
    EXPECT_EQ(replay.next_due_us(), first_us);
    EXPECT_FALSE(replay.pop_due(first_us - 1));
    EXPECT_TRUE(replay.pop_due(first_us));
    EXPECT_EQ(replay.position_us(first_us), kReplayAt + 100 * kReplayMs);
    EXPECT_FALSE(replay.pop_due(first_us));
  }
}

TEST(Replay, APauseLastsUntilTheNextSeekIsShown) {
  Replay replay;
  EXPECT_EQ(replay.paused_us(kReplayNow), 0);
  replay.add(replayed(0, {0}, true), true);
  (void)replay.pop_due(kReplayNow);
  EXPECT_EQ(replay.paused_us(kReplayNow + 7), 7);
  replay.add(replayed(0, {100 * kReplayMs}, true), true);
  (void)replay.pop_due(kReplayNow + 7);
  EXPECT_EQ(replay.paused_us(kReplayNow + 8), 1);
  replay.add(replayed(1, {200 * kReplayMs}, true), true);
  (void)replay.pop_due(kReplayNow + 9);
  EXPECT_EQ(replay.paused_us(kReplayNow + 10), 0);
}

TEST(Replay, WhatComesLateIsNotCaughtUpWith) {
  Replay replay;
  replay.add(replayed(1, {0}, true), true);
  (void)replay.pop_due(kReplayNow);
  replay.add(replayed(1, {100 * kReplayMs, 200 * kReplayMs}, false), false);
  const TimeUs late_us = kReplayNow + 3'000 * kReplayMs;
  EXPECT_TRUE(replay.pop_due(late_us));
  EXPECT_FALSE(replay.pop_due(late_us));
  EXPECT_EQ(replay.next_due_us(), late_us + 100 * kReplayMs);
}

TEST(Replay, NobodyWaitsThroughAGapButForASeam) {
  for (const TimeUs next_us : {900 * kReplayMs, 3'600'000 * kReplayMs}) {
    Replay replay;
    replay.add(replayed(1, {0}, true), true);
    (void)replay.pop_due(kReplayNow);
    replay.add(replayed(1, {next_us, next_us + 100 * kReplayMs}, true), false);
    const TimeUs due_us = next_us > PastReader::kSeamUs ? kReplayNow : kReplayNow + next_us;
    EXPECT_EQ(replay.next_due_us(), due_us);
    EXPECT_TRUE(replay.pop_due(due_us)->begins);
    EXPECT_EQ(replay.position_us(due_us), kReplayAt + next_us);
    EXPECT_EQ(replay.next_due_us(), due_us + 100 * kReplayMs);
  }
}

TEST(Replay, ReadsALittleAheadAndStopsWhereItStands) {
  Replay replay;
  replay.add(replayed(4, {0}, true), true);
  EXPECT_FALSE(replay.wants(kReplayNow)) << "the first picture comes first";
  (void)replay.pop_due(kReplayNow);
  EXPECT_EQ(replay.wants(kReplayNow), kReplayAt + 2 * 4 * Replay::kAheadUs);
  replay.add(replayed(4, {100 * kReplayMs, 8 * Replay::kAheadUs}, false), false);
  EXPECT_FALSE(replay.wants(kReplayNow));
  EXPECT_TRUE(replay.wants(kReplayNow + 2 * Replay::kAheadUs));
  replay.add(replayed(0, {0}, true), true);
  (void)replay.pop_due(kReplayNow);
  EXPECT_FALSE(replay.wants(kReplayNow));
  EXPECT_FALSE(replay.next_due_us());
  EXPECT_FALSE(replay.is_over());
}

TEST(Replay, IsOverOnceAllIsShown) {
  Replay replay;
  replay.add(replayed(1, {0}, true), true);
  (void)replay.pop_due(kReplayNow);
  replay.add(replayed(1, {100 * kReplayMs}, false, true), false);
  EXPECT_FALSE(replay.is_over());
  EXPECT_FALSE(replay.wants(kReplayNow));
  (void)replay.pop_due(kReplayNow + 100 * kReplayMs);
  EXPECT_TRUE(replay.is_over());
}

}  // namespace
}  // namespace eigencast::broker
