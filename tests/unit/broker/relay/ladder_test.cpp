// SPDX-License-Identifier: MIT
#include "broker/relay/ladder.h"

#include <gtest/gtest.h>

namespace eigencast::broker {
namespace {

class LadderTest : public ::testing::Test {
 protected:
  /// Passes one second with these counts.
  std::optional<Ladder::Step> second(std::uint64_t sent, std::uint64_t dropped, std::uint64_t joins = 0) {
    counts_.sent += sent;
    counts_.dropped += dropped;
    counts_.joins += joins;
    return ladder_.check(counts_, 4);
  }
  std::optional<Ladder::Step> bad_seconds(int seconds) {
    std::optional<Ladder::Step> step;
    for (int i = 0; i < seconds && !step; ++i) step = second(50, 40);
    return step;
  }
  /// How many good seconds it takes to climb; -1: more than `most`.
  int seconds_to_climb(int most) {
    for (int i = 1; i <= most; ++i) {
      const auto step = second(90, 0);
      if (!step) continue;
      EXPECT_FALSE(step->down);
      return i;
    }
    return -1;
  }
  Ladder::Counts counts_;
  Ladder ladder_{Profile{.scheme = Profile::Scheme::kCatmullRom}};
};

TEST_F(LadderTest, DescendsFromAskedToFewerBands) {
  std::vector<Profile> seen;
  while (const auto step = bad_seconds(2)) {
    EXPECT_TRUE(step->down);
    EXPECT_FALSE(step->why.empty());
    seen.push_back(step->profile);
    ASSERT_LT(seen.size(), 10u);
  }
  Profile raw;
  raw.rate = Profile::Rate::kRaw;
  std::vector<Profile> wanted{Profile{}, raw};
  for (const std::uint8_t bands : {3, 2, 1}) {
    raw.bands = bands;
    wanted.push_back(raw);
  }
  EXPECT_EQ(seen, wanted);
  EXPECT_FALSE(bad_seconds(5)) << "there is nothing below the last rung, and no disconnect";
}

TEST_F(LadderTest, OneBadSecondIsNotEnough) {
  for (int i = 0; i < 20; ++i) {
    EXPECT_FALSE(second(50, 40));
    EXPECT_FALSE(second(90, 0));
  }
}

TEST_F(LadderTest, RepeatedJoinsLeadDown) {
  EXPECT_FALSE(second(90, 1, 2));
  EXPECT_TRUE(second(90, 1, 2));
}

TEST_F(LadderTest, StalledReaderKeepsItsRung) {
  for (int i = 0; i < 60; ++i) EXPECT_FALSE(second(0, 90));
  EXPECT_FALSE(second(60, 30, 1)) << "it wakes";
  EXPECT_FALSE(second(90, 0));
  EXPECT_EQ(ladder_.rung(), 0u);
}

TEST_F(LadderTest, ClimbsMoreSlowlyAfterRelapses) {
  int last = 0;
  for (int i = 0; i < 4; ++i) {
    ASSERT_TRUE(bad_seconds(2));
    const int seconds = seconds_to_climb(200);
    ASSERT_GT(seconds, 0);
    EXPECT_GE(seconds, last * 3 / 2) << "hysteresis";
    last = seconds;
    EXPECT_EQ(ladder_.rung(), 0u);
  }
  EXPECT_LE(last, 160);
}

TEST(LadderOfOthersTest, WhatNeedsNoResidualsGoesToRaw) {
  for (const char* query : {"", "scheme=hermite", "rate=estimated", "rate=estimated&scheme=linear"}) {
    Ladder ladder(profile_from_query(query).value());
    EXPECT_FALSE(ladder.check({10, 10, 5}, 4));
    const auto step = ladder.check({20, 20, 10}, 4);
    ASSERT_TRUE(step) << query;
    EXPECT_EQ(step->profile, profile_from_query("rate=raw").value()) << query;
  }
}

TEST(LadderOfOthersTest, TopRungIsTheRequestedProfile) {
  Profile asked;
  asked.rate = Profile::Rate::kRaw;
  asked.bands = 2;
  Ladder ladder(asked);
  EXPECT_FALSE(ladder.check({10, 10, 5}, 4));
  const auto step = ladder.check({20, 20, 10}, 4);
  ASSERT_TRUE(step);
  EXPECT_EQ(step->profile.rate, Profile::Rate::kRaw);
  EXPECT_EQ(step->profile.bands, 1);
}

}  // namespace
}  // namespace eigencast::broker
