// SPDX-License-Identifier: MIT
#include "tests/support/impaired_path.h"

#include <gtest/gtest.h>

#include <vector>

namespace eigencast::testing {
namespace {

constexpr TimeUs kMs = 1000;

std::vector<TimeUs> delays_of(const Impairment& impairment, int count, TimeUs every_us, std::size_t bytes = 200) {
  ImpairedPath path(impairment);
  ImpairedPath::Flow flow;
  std::vector<TimeUs> delays;
  for (int i = 0; i < count; ++i) {
    const TimeUs now_us = 1'000'000 + i * every_us;
    delays.push_back(path.leaves_at(flow, bytes, now_us) - now_us);
  }
  return delays;
}

TEST(ImpairedPath, AnUnimpairedLinkIsNoLink) {
  for (const TimeUs delay : delays_of({}, 100, 10)) EXPECT_EQ(delay, 0);
}

TEST(ImpairedPath, FixedDelayIsAdded) {
  for (const TimeUs delay : delays_of({.delay_us = 25 * kMs}, 100, 10 * kMs)) EXPECT_EQ(delay, 25 * kMs);
}

TEST(ImpairedPath, JitterFillsItsRangeInOrder) {
  const Impairment link{.delay_us = 20 * kMs, .jitter_us = 5 * kMs};
  TimeUs least = 1'000'000, most = 0, sum = 0;
  for (const TimeUs delay : delays_of(link, 1000, 33 * kMs)) {
    least = std::min(least, delay);
    most = std::max(most, delay);
    sum += delay;
  }
  EXPECT_GE(least, 15 * kMs);
  EXPECT_LT(least, 16 * kMs);
  EXPECT_LE(most, 25 * kMs);
  EXPECT_GT(most, 24 * kMs);
  EXPECT_NEAR(static_cast<double>(sum) / 1000, 20'000, 300);

  ImpairedPath path(link);
  ImpairedPath::Flow flow;
  TimeUs last = 0;
  for (int i = 0; i < 1000; ++i) {
    const TimeUs out = path.leaves_at(flow, 200, i * kMs);
    EXPECT_GE(out, last);
    last = out;
  }
}

TEST(ImpairedPath, SeedDeterminesTheLink) {
  const Impairment link{.delay_us = 150 * kMs, .jitter_us = 50 * kMs, .loss = 0.05, .seed = 7};
  Impairment other = link;
  other.seed = 8;
  EXPECT_EQ(delays_of(link, 500, kMs), delays_of(link, 500, kMs));
  EXPECT_NE(delays_of(link, 500, kMs), delays_of(other, 500, kMs));
}

TEST(ImpairedPath, FlowsShareTheRate) {
  ImpairedPath path({.rate_bit_per_s = 8e6});  // One byte a microsecond.
  ImpairedPath::Flow a, b;
  EXPECT_EQ(path.leaves_at(a, 1000, 0), 1000);
  EXPECT_EQ(path.leaves_at(b, 1000, 0), 2000);
  EXPECT_EQ(path.busy_until_us(), 2000);
  EXPECT_EQ(path.leaves_at(a, 500, 10'000), 10'500) << "an idle link saves nothing up";
}

TEST(ImpairedPath, LossBlocksItsOwnFlowOnly) {
  const Impairment link{.delay_us = 10 * kMs, .loss = 0.5, .retransmit_us = 100 * kMs, .seed = 3};
  ImpairedPath path(link);
  ImpairedPath::Flow flow;
  TimeUs blocked_until = 0;
  int held_up = 0, lost = 0;
  for (int i = 0; i < 200; ++i) {
    const TimeUs now = i * kMs;
    const std::uint64_t before = path.segments_lost();
    const TimeUs out = path.leaves_at(flow, 100, now);
    if (path.segments_lost() == before) {
      EXPECT_EQ(out, std::max(blocked_until, now + 10 * kMs));
      held_up += out > now + 10 * kMs;
    } else {
      ++lost;
      EXPECT_GE(out, now + 110 * kMs);
      blocked_until = std::max(blocked_until, out);
    }
  }
  EXPECT_GT(held_up, 20);
  EXPECT_NEAR(lost, 100, 30);
}

TEST(ImpairedPath, LossRateIsAsSet) {
  const Impairment link{.loss = 0.05};
  ImpairedPath path(link);
  for (int i = 0; i < 20'000; ++i) {
    ImpairedPath::Flow flow;
    path.leaves_at(flow, 100, i * kMs);
  }
  EXPECT_NEAR(static_cast<double>(path.segments_lost()), 20'000 * 0.05 / 0.95, 120);
}

TEST(ImpairedPath, StallHoldsEverything) {
  ImpairedPath path({.stall_every_us = 1000 * kMs, .stall_us = 200 * kMs});
  ImpairedPath::Flow flow;
  EXPECT_EQ(path.leaves_at(flow, 100, 0), 0);
  EXPECT_EQ(path.leaves_at(flow, 100, 799 * kMs), 799 * kMs);
  EXPECT_EQ(path.leaves_at(flow, 100, 850 * kMs), 1000 * kMs);
  EXPECT_EQ(path.leaves_at(flow, 100, 1100 * kMs), 1100 * kMs);
}

TEST(ImpairedPath, WhatCannotBeMeantIsRefused) {
  EXPECT_TRUE(check_impairment({}));
  EXPECT_FALSE(check_impairment({.delay_us = -1}));
  EXPECT_FALSE(check_impairment({.delay_us = 1, .jitter_us = 2}));
  EXPECT_FALSE(check_impairment({.rate_bit_per_s = -1}));
  EXPECT_FALSE(check_impairment({.loss = 0.6}));
  EXPECT_FALSE(check_impairment({.stall_every_us = 10, .stall_us = 10}));
}

}  // namespace
}  // namespace eigencast::testing
