// SPDX-License-Identifier: MIT
#include "tools/latency/over_time.h"

#include <gtest/gtest.h>

namespace eigencast::latency {
namespace {

TEST(ClockTrack, DriftIsWithinItsBound) {
  ClockTrack track;
  for (int i = 0; i < 100; ++i) {
    const TimeUs at_us = i * 250'000;
    const TimeUs noise_us = (i * 7919) % 41 - 20;
    track.add({at_us, -5'000'000 + at_us * 30 / 1'000'000 + noise_us, 50 + i % 30});
  }
  const auto drift = track.drift();
  ASSERT_TRUE(drift);
  EXPECT_NEAR(drift->ppm, 30, drift->error_ppm);
  EXPECT_NEAR(drift->ppm, 30, 2);
  EXPECT_EQ(track.best()->error_us, 50);
}

TEST(ClockTrack, OnePointHasNoDrift) {
  ClockTrack track;
  EXPECT_FALSE(track.best());
  track.add({0, 5, 10});
  track.add({2'000'000, 5, 10});
  EXPECT_EQ(track.points().size(), 1u);
  EXPECT_FALSE(track.drift());
  track.add({500'000, 6, 10});
  EXPECT_FALSE(track.drift()) << "below a second";
}

TEST(ClockTrack, LongRunsAreThinned) {
  ClockTrack track;
  for (TimeUs i = 0; i < 20'000; ++i) track.add({i * 1000, i, 10});
  EXPECT_LE(track.points().size(), ClockTrack::kMaxPoints);
  EXPECT_EQ(track.points().front().at_us, 0);
  EXPECT_EQ(track.points().back().at_us, 19'999'000);
  EXPECT_NEAR(track.drift()->ppm, 1000, 1);
}

}  // namespace
}  // namespace eigencast::latency
