// SPDX-License-Identifier: MIT
#include "common/motion/playout.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

namespace eigencast {
namespace {

constexpr TimeUs kMs = 1000;
constexpr TimeUs kInterval = 40 * kMs;
constexpr TimeUs kSenderZero = 5'000'000'000;

// The pose's one coefficient is its own media time in seconds: what is shown says when it was.
TimedPose pose_at(TimeUs media_us) {
  return {media_us, {static_cast<double>(media_us - kSenderZero) * 1e-6}};
}

// Shows 60 pictures a second while poses come; calls show(now, pose) for each.
template <typename DelayOf, typename Show>
void play(Playout& playout, int poses, DelayOf delay_of, double drift, Show show) {
  TimeUs now_us = 0, last_us = 0;
  for (int i = 0; i < poses; ++i) {
    const TimeUs made_us = i * kInterval;
    last_us = std::max(last_us, made_us + delay_of(i));
    for (; now_us < last_us; now_us += 16'667) {
      if (const auto pose = playout.at(now_us)) show(now_us, *pose);
    }
    const auto media_us = kSenderZero + static_cast<TimeUs>(static_cast<double>(made_us) * (1 + drift));
    ASSERT_TRUE(playout.add(pose_at(media_us), last_us));
  }
}

TEST(Playout, ShowsNothingBeforeTheFirstPose) {
  for (const auto mode : {PlayoutMode::kLatest, PlayoutMode::kInterpolate, PlayoutMode::kEstimate}) {
    Playout playout(mode);
    EXPECT_FALSE(playout.at(0));
    playout.add(pose_at(kSenderZero), 0);
    EXPECT_TRUE(playout.at(0));
    playout.reset();
    EXPECT_FALSE(playout.at(0));
  }
}

TEST(Playout, OldPosesAreRefused) {
  Playout playout(PlayoutMode::kLatest);
  EXPECT_TRUE(playout.add(pose_at(1000), 0));
  EXPECT_FALSE(playout.add(pose_at(1000), 1));
  EXPECT_FALSE(playout.add(pose_at(999), 2));
  EXPECT_EQ(playout.at(3)->time_us, 1000);
}

TEST(Playout, LatestShowsTheNewestAsItIs) {
  Playout playout(PlayoutMode::kLatest);
  playout.add(pose_at(0), 0);
  playout.add(pose_at(kInterval), 200 * kMs);
  EXPECT_EQ(playout.at(200 * kMs)->coefficients, pose_at(kInterval).coefficients);
}

TEST(Playout, MovesEvenlyUnderJitter) {
  std::mt19937 random(2);
  std::uniform_int_distribution<TimeUs> jitter(0, 30 * kMs);
  Playout playout(PlayoutMode::kInterpolate);
  TimeUs shown_us = 0;
  TimeUs before_us = std::numeric_limits<TimeUs>::min();
  int uneven = 0, pictures = 0;
  play(
      playout, 1000, [&](int) { return 10 * kMs + jitter(random); }, 0,
      [&](TimeUs now_us, const TimedPose& pose) {
        EXPECT_GE(pose.time_us, before_us) << "media time ran back";
        EXPECT_NEAR(pose.coefficients[0], static_cast<double>(pose.time_us - kSenderZero) * 1e-6, 1e-9);
        if (now_us > 2'000 * kMs) {
          ++pictures;
          const double step = static_cast<double>(pose.time_us - before_us) / static_cast<double>(now_us - shown_us);
          if (std::abs(step - 1) > 0.06) ++uneven;
          // The delay that was promised: way, jitter, one interval.
          EXPECT_LT(now_us - (pose.time_us - kSenderZero), 10 * kMs + 30 * kMs + kInterval + 5 * kMs);
        }
        before_us = pose.time_us;
        shown_us = now_us;
      });
  EXPECT_LT(uneven, pictures / 20);
}

TEST(Playout, FollowsDriftingClocks) {
  for (const double drift : {-5e-4, 5e-4}) {
    Playout playout(PlayoutMode::kInterpolate, 60 * kMs);
    TimeUs before_us = std::numeric_limits<TimeUs>::min();
    play(
        playout, 7500, [](int) { return 10 * kMs; }, drift,
        [&](TimeUs now_us, const TimedPose& pose) {
          EXPECT_GE(pose.time_us, before_us);
          before_us = pose.time_us;
          // Five minutes, 150 ms of drift: the delay in true time stays what it was.
          const double made_us = static_cast<double>(pose.time_us - kSenderZero) / (1 + drift);
          if (now_us > 200 * kMs) {
            EXPECT_NEAR(static_cast<double>(now_us) - made_us, 70 * kMs, 4 * kMs);
          }
        });
  }
}

TEST(Playout, EstimateRunsAheadAndStopsAtTheLimit) {
  Playout playout(PlayoutMode::kEstimate, 0, 100 * kMs);
  playout.add(pose_at(kSenderZero), 10 * kMs);
  EXPECT_EQ(playout.at(500 * kMs)->time_us, kSenderZero) << "one pose has no direction";
  playout.add(pose_at(kSenderZero + kInterval), 10 * kMs + kInterval);
  const auto ahead = playout.at(80 * kMs);
  EXPECT_EQ(ahead->time_us, kSenderZero + 70 * kMs);
  EXPECT_NEAR(ahead->coefficients[0], 0.070, 1e-12);
  const auto held = playout.at(900 * kMs);
  EXPECT_EQ(held->time_us, kSenderZero + kInterval + 100 * kMs);
  EXPECT_NEAR(held->coefficients[0], 0.140, 1e-12);
}

TEST(Playout, StartsAnewWhenTheSendersClockJumps) {
  Playout playout(PlayoutMode::kInterpolate);
  for (int i = 0; i < 50; ++i) playout.add(pose_at(kSenderZero + i * kInterval), i * kInterval);
  const TimeUs jump_us = 3'600'000 * kMs;
  for (int i = 50; i < 60; ++i) playout.add(pose_at(kSenderZero + jump_us + i * kInterval), i * kInterval);
  const auto pose = playout.at(59 * kInterval);
  EXPECT_NEAR(pose->time_us, kSenderZero + jump_us + 58 * kInterval, kInterval);
}

TEST(Playout, PauseHoldsThePoseAndGoesOn) {
  Playout playout(PlayoutMode::kInterpolate);
  for (int i = 0; i < 50; ++i) playout.add(pose_at(kSenderZero + i * kInterval), i * kInterval);
  EXPECT_EQ(playout.at(60'000 * kMs)->time_us, kSenderZero + 49 * kInterval);
  const TimeUs later_us = 60'000 * kMs;
  for (int i = 0; i < 5; ++i) playout.add(pose_at(kSenderZero + later_us + i * kInterval), later_us + i * kInterval);
  EXPECT_NEAR(playout.at(later_us + 4 * kInterval)->time_us, kSenderZero + later_us + 3 * kInterval, 2 * kMs);
}

TEST(Playout, PosesOfAnotherSizeReplaceTheOthers) {
  Playout playout(PlayoutMode::kInterpolate);
  playout.add({0, {1, 2, 3}}, 0);
  playout.add({kInterval, {1, 2}}, kInterval);
  EXPECT_EQ(playout.at(kInterval)->coefficients.size(), 2U);
}

TEST(Playout, HoldsABoundedNumberOfPosesAndSurvivesHostileTimes) {
  Playout playout(PlayoutMode::kInterpolate);
  for (int i = 0; i < 1000; ++i) playout.add(pose_at(i * kMs), 0);
  // All but the newest kMaxPoses are gone: even the far past shows the oldest of these.
  EXPECT_EQ(playout.at(-1'000'000 * kMs)->time_us, (1000 - static_cast<TimeUs>(Playout::kMaxPoses)) * kMs);

  constexpr TimeUs kLow = std::numeric_limits<TimeUs>::min(), kHigh = std::numeric_limits<TimeUs>::max();
  for (const auto mode : {PlayoutMode::kInterpolate, PlayoutMode::kEstimate}) {
    Playout hostile(mode);
    hostile.add({kLow, {1}}, kHigh);
    hostile.add({kLow + 1, {1}}, kHigh);
    hostile.add({0, {1}}, kLow);
    hostile.add({kHigh - 1, {1}}, 0);
    hostile.add({kHigh, {1}}, kHigh);
    for (const TimeUs now_us : {kLow, TimeUs{0}, kHigh}) EXPECT_EQ(hostile.at(now_us)->coefficients.size(), 1U);
  }
}

}  // namespace
}  // namespace eigencast
