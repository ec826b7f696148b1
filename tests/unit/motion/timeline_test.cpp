// SPDX-License-Identifier: MIT
#include "common/motion/timeline.h"

#include <gtest/gtest.h>

namespace eigencast {
namespace {

constexpr TimeUs kStart = 7'000'000;

/// Four frames, ten a second.
Timeline short_clip() {
  return {{0, 100'000, 200'000, 300'000}, 400'000, kStart};
}

TEST(Timeline, PlaysFromTheStartInALoop) {
  const Timeline timeline = short_clip();
  EXPECT_EQ(timeline.at(kStart).position_us, 0);
  EXPECT_EQ(timeline.at(kStart + 350'000).position_us, 350'000);
  EXPECT_EQ(timeline.frame_at(350'000), 3u);
  EXPECT_EQ(timeline.at(kStart + 400'000).position_us, 0);
  EXPECT_EQ(timeline.at(kStart + 1'250'000).position_us, 50'000);
  EXPECT_EQ(timeline.at(kStart + 1'250'000).lap, 3);
  EXPECT_EQ(timeline.at(kStart - 50'000).position_us, 350'000) << "before its start";
  EXPECT_EQ(timeline.until_next_us(kStart + 1'250'000), 50'000);
  EXPECT_EQ(timeline.until_next_us(kStart + 1'599'999), 1) << "the first frame comes again";
}

TEST(Timeline, EveryFrameIsPlayedOnce) {
  const Timeline timeline = short_clip();
  TimeUs now = kStart;
  for (std::int64_t number = 0; number < 20; ++number) {
    const Timeline::Moment moment = timeline.at(now);
    EXPECT_EQ(moment.lap * 4 + static_cast<std::int64_t>(timeline.frame_at(moment.position_us)), number);
    now += timeline.until_next_us(now).value();
  }
}

TEST(Timeline, WithoutLoopItHoldsItsLastFrame) {
  Timeline timeline = short_clip();
  timeline.set_looping(false, kStart);
  EXPECT_EQ(timeline.at(kStart + 5'000'000).position_us, 300'000);
  EXPECT_EQ(timeline.until_next_us(kStart + 5'000'000), std::nullopt);
  timeline.set_paused(true, kStart + 5'000'000);
  timeline.set_paused(false, kStart + 6'000'000);
  EXPECT_EQ(timeline.at(kStart + 6'100'000).position_us, 100'000) << "play at the end begins anew";
  timeline.set_looping(true, kStart + 6'100'000);
  EXPECT_EQ(timeline.at(kStart + 6'500'000).position_us, 100'000) << "and goes round again";
  timeline.set_looping(false, kStart + 6'790'000);
  EXPECT_EQ(timeline.at(kStart + 6'790'000).position_us, 300'000) << "no position is after the last frame";
}

TEST(Timeline, SeeksWithinTheClip) {
  Timeline timeline = short_clip();
  timeline.seek(250'000, kStart + 30'000);
  EXPECT_EQ(timeline.at(kStart + 40'000).position_us, 260'000);
  timeline.seek(-5, kStart);
  EXPECT_EQ(timeline.at(kStart).position_us, 0);
  timeline.seek(9'000'000, kStart);
  EXPECT_EQ(timeline.at(kStart).position_us, 300'000) << "beyond the end: its last frame";
  timeline.set_paused(true, kStart);
  timeline.seek(150'000, kStart);
  EXPECT_EQ(timeline.at(kStart + 1'000'000).position_us, 150'000) << "a pause outlives a seek";
}

TEST(Timeline, StepsPauseOnFrames) {
  Timeline timeline = short_clip();
  timeline.step(1, kStart + 50'000);
  EXPECT_TRUE(timeline.paused());
  EXPECT_EQ(timeline.at(kStart + 900'000).position_us, 100'000);
  timeline.step(-1, kStart);
  timeline.step(-1, kStart);
  EXPECT_EQ(timeline.at(kStart).position_us, 300'000) << "back across the loop";
  timeline.step(1, kStart);
  EXPECT_EQ(timeline.at(kStart).position_us, 0) << "and forth";
  timeline.seek(150'000, kStart);
  timeline.step(-1, kStart);
  EXPECT_EQ(timeline.at(kStart).position_us, 100'000) << "from between two frames";
  timeline.set_looping(false, kStart);
  timeline.step(-2, kStart);
  EXPECT_EQ(timeline.at(kStart).position_us, 0) << "without loop the ends hold";
  timeline.step(7, kStart);
  EXPECT_EQ(timeline.at(kStart).position_us, 300'000);
}

TEST(Timeline, SpeedChangesWithoutAJump) {
  Timeline timeline = short_clip();
  for (const double speed : {0.1, 0.5, 2.0, 10.0}) {
    timeline.seek(0, kStart);
    timeline.set_speed(speed, kStart + 1000);
    const TimeUs before = timeline.at(kStart + 1000).position_us;
    EXPECT_EQ(timeline.at(kStart + 11'000).position_us - before, static_cast<TimeUs>(10'000 * speed));
    timeline.set_speed(1, kStart + 11'000);
    EXPECT_EQ(timeline.at(kStart + 11'000).position_us - before, static_cast<TimeUs>(10'000 * speed));
  }
  timeline.set_speed(99, kStart);
  EXPECT_EQ(timeline.speed(), Timeline::kMaxSpeed);
  timeline.set_speed(0, kStart);
  EXPECT_EQ(timeline.speed(), Timeline::kMinSpeed);
  timeline.seek(90'000, kStart);
  EXPECT_EQ(timeline.until_next_us(kStart), 100'000) << "in display time";
}

TEST(Timeline, SpeedsFormALadder) {
  EXPECT_EQ(next_speed(1, true), 2);
  EXPECT_EQ(next_speed(1, false), 0.5);
  EXPECT_EQ(next_speed(3, false), 2);
  EXPECT_EQ(next_speed(10, true), 10);
  EXPECT_EQ(next_speed(0.1, false), 0.1);
}

TEST(Timeline, UnevenFramesKeepTheirTimes) {
  Timeline timeline({0, 10'000, 500'000}, 600'000, 0);
  EXPECT_EQ(timeline.frame_at(timeline.at(499'999).position_us), 1u);
  EXPECT_EQ(timeline.until_next_us(10'000), 490'000);
  timeline.step(1, 20'000);
  EXPECT_EQ(timeline.at(0).position_us, 500'000);
}

TEST(Timeline, StillsHaveOneFrame) {
  Timeline timeline({0}, 33'333, 0);
  EXPECT_EQ(timeline.at(100'000).lap, 3);
  timeline.step(-1, 0);
  EXPECT_EQ(timeline.at(0).position_us, 0);
}

}  // namespace
}  // namespace eigencast
