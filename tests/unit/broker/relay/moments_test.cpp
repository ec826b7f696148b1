// SPDX-License-Identifier: MIT
#include "broker/relay/moments.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <limits>

namespace eigencast::broker {
namespace {

constexpr TimeUs kMost = 300'000, kSecond = 1'000'000;

TEST(MomentsTest, AGroupIsAsLateAsTheViewerThatNeedsMost) {
  Moments moments;
  const auto near = moments.join("g", "a"), far = moments.join("g", "a");
  EXPECT_FALSE(moments.lag_us(near, 0, kMost)) << "nothing has arrived";
  moments.note_arrival(near, 1'000, kSecond);
  moments.note_arrival(far, 3'000, kSecond);
  moments.report(near, 41'000, kSecond);
  moments.report(far, 111'000, kSecond);
  EXPECT_EQ(moments.lag_us(near, kSecond, kMost), 111'000);
  EXPECT_EQ(moments.lag_us(far, kSecond, kMost), 111'000);
}

TEST(MomentsTest, TheBoundLeavesTooSlowAndFalseOnesBehind) {
  for (const TimeUs evil :
       {TimeUs{2'000'000}, std::numeric_limits<TimeUs>::max(), std::numeric_limits<TimeUs>::min()}) {
    Moments moments;
    const auto near = moments.join("g", "a"), far = moments.join("g", "a");
    moments.note_arrival(near, 1'000, 0);
    moments.report(near, 41'000, 0);
    moments.report(far, evil, 0);
    EXPECT_EQ(moments.lag_us(near, 0, kMost), evil > 0 ? 301'000 : 41'000);
  }
}

TEST(MomentsTest, StreamsOfAGroupHaveOneDelayBehindTheirFastestArrivals) {
  Moments moments;
  const auto a = moments.join("g", "a"), b = moments.join("g", "b"), other = moments.join("h", "a");
  moments.note_arrival(a, -5'000'000, 0);  // Of a sender whose clock is ahead.
  moments.note_arrival(b, 7'000'000, 0);
  moments.note_arrival(other, -5'000'000, 0);
  moments.report(a, -4'960'000, 0);
  moments.report(b, 7'090'000, 0);
  moments.report(other, -4'990'000, 0);
  EXPECT_EQ(moments.lag_us(a, 0, kMost), -4'910'000);
  EXPECT_EQ(moments.lag_us(b, 0, kMost), 7'090'000);
  EXPECT_EQ(moments.lag_us(other, 0, kMost), -4'990'000) << "another group";
}

TEST(MomentsTest, ChangesAreSlowerThanViewersFollow) {
  Moments moments;
  const auto one = moments.join("g", "a"), late = moments.join("g", "a");
  moments.note_arrival(one, 5'000, 0);
  moments.report(one, 25'000, 0);
  TimeUs lag = *moments.lag_us(one, 0, kMost);
  for (TimeUs now = 0; now < 20'000'000; now += 10'000) {
    if (now % 30'000 == 0) moments.note_arrival(one, 5'000 + now % 7, now);
    if (now % 250'000 == 0) {
      moments.report(one, 25'000, now);
      if (now >= 1'000'000 && now < 9'000'000) moments.report(late, 225'000, now);
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
  moments.report(silent, 200'000, 0);
  for (TimeUs now = 0; now <= 20'000'000; now += 100'000) {
    moments.note_arrival(one, 0, now);
    moments.report(one, 20'000, now);
    (void)moments.lag_us(one, now, kMost);
  }
  EXPECT_EQ(moments.lag_us(one, 20'000'000, kMost), 20'000);
  EXPECT_EQ(moments.lag_us(silent, 20'000'000, kMost), 20'000);
}

TEST(MomentsTest, ASendersClockThatIsSetIsFollowedAtOnce) {
  Moments moments;
  const auto one = moments.join("g", "a");
  moments.note_arrival(one, 1'000, 0);
  moments.report(one, 21'000, 0);
  EXPECT_EQ(moments.lag_us(one, 0, kMost), 21'000);
  for (const TimeUs set : {TimeUs{3'600'000'000}, TimeUs{-3'600'000'000}}) {
    const TimeUs now = set > 0 ? kSecond : 2 * kSecond;
    moments.note_arrival(one, set, now);
    moments.report(one, set + 20'000, now);
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

}  // namespace
}  // namespace eigencast::broker
