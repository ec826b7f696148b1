// SPDX-License-Identifier: MIT
#include "broker/relay/moments.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <limits>
#include <vector>

namespace eigencast::broker {
namespace {

constexpr TimeUs kMost = 300'000, kSecond = 1'000'000;

TEST(MomentsTest, AGroupIsAsLateAsTheViewerThatNeedsMost) {
  Moments moments;
  const auto near = moments.join("g", "a"), far = moments.join("g", "a");
  EXPECT_FALSE(moments.lag_us(near, 0, kMost)) << "nothing has arrived";
  moments.note_arrival(near, 1'000, kSecond);
  moments.note_arrival(far, 3'000, kSecond);
  moments.report(near, "who", 41'000, kSecond);
  moments.report(far, "who", 111'000, kSecond);
  EXPECT_EQ(moments.lag_us(near, kSecond, kMost), 111'000);
  EXPECT_EQ(moments.lag_us(far, kSecond, kMost), 111'000);
  EXPECT_EQ(moments.delay_us(near), 110'000) << "behind the fastest arrival";
  EXPECT_EQ(moments.delay_us(99), 0) << "who is gone";
}

TEST(MomentsTest, TheBoundLeavesTooSlowAndFalseOnesBehind) {
  for (const TimeUs evil :
       {TimeUs{2'000'000}, std::numeric_limits<TimeUs>::max(), std::numeric_limits<TimeUs>::min()}) {
    Moments moments;
    const auto near = moments.join("g", "a"), far = moments.join("g", "a");
    moments.note_arrival(near, 1'000, 0);
    moments.report(near, "who", 41'000, 0);
    moments.report(far, "who", evil, 0);
    EXPECT_EQ(moments.lag_us(near, 0, kMost), evil > 0 ? 301'000 : 41'000);
  }
}

TEST(MomentsTest, StreamsOfAGroupHaveOneDelayBehindTheirFastestArrivals) {
  Moments moments;
  const auto a = moments.join("g", "a"), b = moments.join("g", "b"), other = moments.join("h", "a");
  moments.note_arrival(a, -5'000'000, 0);  // Of a sender whose clock is ahead.
  moments.note_arrival(b, 7'000'000, 0);
  moments.note_arrival(other, -5'000'000, 0);
  moments.report(a, "who", -4'960'000, 0);
  moments.report(b, "who", 7'090'000, 0);
  moments.report(other, "who", -4'990'000, 0);
  EXPECT_EQ(moments.lag_us(a, 0, kMost), -4'910'000);
  EXPECT_EQ(moments.lag_us(b, 0, kMost), 7'090'000);
  EXPECT_EQ(moments.lag_us(other, 0, kMost), -4'990'000) << "another group";
}

TEST(MomentsTest, ChangesAreSlowerThanViewersFollow) {
  Moments moments;
  const auto one = moments.join("g", "a"), late = moments.join("g", "a");
  moments.note_arrival(one, 5'000, 0);
  moments.report(one, "who", 25'000, 0);
  TimeUs lag = *moments.lag_us(one, 0, kMost);
  for (TimeUs now = 0; now < 20'000'000; now += 10'000) {
    if (now % 30'000 == 0) moments.note_arrival(one, 5'000 + now % 7, now);
    if (now % 250'000 == 0) {
      moments.report(one, "who", 25'000, now);
      if (now >= 1'000'000 && now < 9'000'000) moments.report(late, "who", 225'000, now);
    }
    if (now == 9'000'000) moments.leave(late);
    const TimeUs next = *moments.lag_us(one, now, kMost);
    EXPECT_LE(std::abs(next - lag), 10'000 / Moments::kSlew);
    if (now == 8'000'000) {
      EXPECT_EQ(next, 225'000);
    }
    lag = next;
  }
  EXPECT_EQ(lag, 25'000) << "and back, once it has left";
}

TEST(MomentsTest, WhoFallsSilentDoesNotCount) {
  Moments moments;
  const auto one = moments.join("g", "a"), silent = moments.join("g", "a");
  moments.report(silent, "who", 200'000, 0);
  for (TimeUs now = 0; now <= 20'000'000; now += 100'000) {
    moments.note_arrival(one, 0, now);
    moments.report(one, "who", 20'000, now);
    (void)moments.lag_us(one, now, kMost);
  }
  EXPECT_EQ(moments.lag_us(one, 20'000'000, kMost), 20'000);
  EXPECT_EQ(moments.lag_us(silent, 20'000'000, kMost), 20'000);
}

TEST(MomentsTest, ASendersClockThatIsSetIsFollowedAtOnce) {
  Moments moments;
  const auto one = moments.join("g", "a");
  moments.note_arrival(one, 1'000, 0);
  moments.report(one, "who", 21'000, 0);
  EXPECT_EQ(moments.lag_us(one, 0, kMost), 21'000);
  for (const TimeUs set : {TimeUs{3'600'000'000}, TimeUs{-3'600'000'000}}) {
    const TimeUs now = set > 0 ? kSecond : 2 * kSecond;
    moments.note_arrival(one, set, now);
    moments.report(one, "who", set + 20'000, now);
    EXPECT_EQ(moments.lag_us(one, now, kMost), set + 20'000);
  }
}

TEST(MomentsTest, NothingIsLeftOfThoseThatHaveLeft) {
  Moments moments;
  const auto one = moments.join("g", "a"), two = moments.join("g", "b");
  moments.note_arrival(one, 5, 0);
  moments.leave(one);
  moments.leave(one);
  EXPECT_FALSE(moments.lag_us(one, 0, kMost));
  EXPECT_FALSE(moments.lag_us(two, 0, kMost)) << "of its stream nothing has arrived";
  moments.leave(two);
  EXPECT_FALSE(moments.lag_us(moments.join("g", "a"), 0, kMost));
}

TEST(MomentsTest, OfACrowdSomeAreWaitedForWhoeverElseComes) {
  Moments moments;
  std::vector<Moments::Seat> crowd(2'000);
  for (auto& seat : crowd) seat = moments.join("g", "a");
  moments.note_arrival(crowd[0], 0, 0);
  for (const auto seat : crowd) moments.report(seat, "crowd", 10'000, 0);
  const auto other = moments.join("g", "a");
  moments.report(other, "other", 200'000, 0);
  moments.report(crowd.back(), "crowd", 250'000, 0);
  EXPECT_EQ(moments.lag_us(crowd.back(), 0, kMost), 200'000) << "who is not waited for follows";
  for (const auto seat : crowd) moments.leave(seat);
  const auto late = moments.join("g", "a");
  moments.report(late, "crowd", 250'000, 1);
  moments.note_arrival(late, 0, 1);
  TimeUs lag_us = 0;
  for (TimeUs now_us = 1; now_us < 5 * kSecond; now_us += 100'000) lag_us = *moments.lag_us(late, now_us, kMost);
  EXPECT_EQ(lag_us, 250'000) << "there is room again";
}

}  // namespace
}  // namespace eigencast::broker
