// SPDX-License-Identifier: MIT
#include "sdk/stream_pace.h"

#include <gtest/gtest.h>

#include <limits>
#include <vector>

namespace eigencast {
namespace {

constexpr TimeUs kInterval = 40'000;  // of 25 Hz

/// Poses come every `gap_us`; what goes out, taken whenever it is due.
std::vector<int> gone_out(double max_rate_hz, TimeUs gap_us, int poses, std::vector<int>* left = nullptr) {
  PacedQueue<int> queue(max_rate_hz);
  std::vector<int> out;
  TimeUs now = 1'000'000;
  const auto take_due = [&](TimeUs until) {
    for (auto due = queue.due_us(now); due && *due <= until; due = queue.due_us(now)) {
      now = *due;
      out.push_back(queue.take(now));
    }
    now = until;
  };
  for (int i = 0; i < poses; ++i) {
    if (const auto replaced = queue.add(i, now); replaced && left != nullptr) left->push_back(*replaced);
    take_due(now + gap_us);
  }
  take_due(now + kInterval);
  EXPECT_EQ(queue.size(), 0u);
  return out;
}

TEST(PacedQueue, NothingIsLeftOutBelowTheRate) {
  std::vector<int> left;
  EXPECT_EQ(gone_out(25, kInterval, 100, &left).size(), 100u);
  EXPECT_EQ(gone_out(25, 2 * kInterval, 100, &left).size(), 100u);
  EXPECT_EQ(gone_out(std::numeric_limits<double>::infinity(), 1, 1000, &left).size(), 1000u);
  EXPECT_TRUE(left.empty());
}

TEST(PacedQueue, AboveTheRateTheNewestGoesAndTheLastOneIsNeverLost) {
  std::vector<int> left;
  const auto out = gone_out(25, kInterval / 4, 401, &left);
  EXPECT_GE(out.size(), 100u);
  EXPECT_LE(out.size(), 101u + std::size_t{4});
  EXPECT_EQ(out.size() + left.size(), 401u) << "each goes out or is reported";
  EXPECT_EQ(out.back(), 400);
  EXPECT_TRUE(std::is_sorted(out.begin(), out.end()));
}

TEST(PacedQueue, PosesThatComeTogetherGoOutInOrder) {
  PacedQueue<int> queue(25);
  for (const int i : {0, 1, 2, 3}) EXPECT_FALSE(queue.add(i, 0));
  for (const int i : {0, 1, 2, 3}) {
    EXPECT_EQ(queue.due_us(0), 0);
    EXPECT_EQ(queue.take(0), i);
  }
  EXPECT_FALSE(queue.due_us(0));
  EXPECT_FALSE(queue.add(4, 0));
  EXPECT_EQ(queue.due_us(0), kInterval);
  EXPECT_EQ(queue.add(5, 10), 4) << "the newer one takes its place";
  EXPECT_EQ(queue.due_us(kInterval), kInterval);
}

TEST(PacedQueue, ItsLengthIsBounded) {
  PacedQueue<int> queue(std::numeric_limits<double>::infinity());
  int left = 0;
  for (int i = 0; i < 100; ++i) left += queue.add(i, i).has_value() ? 1 : 0;
  EXPECT_EQ(queue.size(), PacedQueue<int>::kLongest);
  EXPECT_EQ(left, 84);
  EXPECT_EQ(queue.take(100), 84) << "the oldest went";
}

TEST(HostTime, FollowsAProgramsClockAndStartsAnewWhereItCannot) {
  HostTime time;
  EXPECT_EQ(time.capture_us(1'000'000, 5.0), 1'000'000);
  EXPECT_EQ(time.capture_us(1'047'000, 5.04), 1'040'000) << "its spacing, not that of the arrivals";
  EXPECT_EQ(time.capture_us(1'075'000, 5.08), 1'080'000);
  EXPECT_EQ(time.capture_us(1'500'000, 5.12), 1'500'000) << "too late";
  EXPECT_EQ(time.capture_us(1'541'000, 5.16), 1'540'000);
  EXPECT_EQ(time.capture_us(1'580'000, 0.0), 1'580'000) << "it runs in a circle";
  EXPECT_EQ(time.capture_us(1'620'000, 0.04), 1'620'000);
  EXPECT_EQ(time.capture_us(1'630'000, 9.0), 1'630'000) << "far ahead";
  EXPECT_EQ(time.capture_us(1'630'000, std::nullopt), 1'630'001) << "times grow";
  time.pass(2'000'000);
  EXPECT_EQ(time.capture_us(1'700'000, std::nullopt), 2'000'001);
}

}  // namespace
}  // namespace eigencast
