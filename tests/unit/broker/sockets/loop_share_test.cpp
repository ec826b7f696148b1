// SPDX-License-Identifier: MIT
#include "broker/sockets/loop_share.h"

#include <gtest/gtest.h>

#include <string>

namespace eigencast::broker {
namespace {

TEST(LoopShare, ACrowdTakesHalfOfTheLoopsTimeAndLeavesOthersTheirTurns) {
  asio::io_context loop;
  LoopShare time(loop);
  const TimeUs began_us = steady_now_us();
  int done = 0, before = -1;
  for (int i = 0; i < 8 * 100; ++i) {
    if (time.take("hog" + std::to_string(i % 8), 500, 0, [&] { ++done; })) ++done;
  }
  const int at_once = done;
  EXPECT_FALSE(time.take("later", 500, 50'000, [&] { EXPECT_GE(steady_now_us() - began_us, 50'000); }));
  EXPECT_FALSE(time.take("other", 500, 0, [&] { before = done; }));
  loop.run();
  EXPECT_EQ(done, 800);
  EXPECT_LE(before - at_once, 9) << "one of each";
  EXPECT_GE(steady_now_us() - began_us, 2 * (802 * 500) - 7'000);
}

/// Memory that is given back at once starts nothing at once: those who waited for it take turns, and few ask.
TEST(LoopShare, WhoIsShortOfMemoryWaitsForItBeforeItsTurn) {
  using Supply = LoopShare::Supply;
  asio::io_context loop;
  LoopShare time(loop);
  constexpr int kEach = 300, kHolders = 4, kUs = 500;
  int room = 0, asked = 0, done = 0, gone = 0;
  const auto hold = [&] {
    ++asked;
    return room > 0 ? --room, Supply::kHeld : Supply::kShort;
  };
  for (int i = 0; i < kEach * kHolders; ++i) {
    EXPECT_FALSE(time.take("hog" + std::to_string(i % kHolders), kUs, 0, [&] { ++done; }, hold));
  }
  EXPECT_EQ(asked, kHolders) << "others stand behind";
  const auto leave = [&] { return ++gone == 1 ? Supply::kShort : Supply::kGone; };
  EXPECT_FALSE(time.take("gone", kUs, 0, [&] { ++done; }, leave));
  while (asked < 3 * kHolders) loop.run_one();
  EXPECT_EQ(asked, 3 * kHolders) << "one of each a time";
  EXPECT_TRUE(time.take("rich", kUs, 0, {}, [] { return Supply::kHeld; })) << "who has memory waits for nobody";
  room = kEach * kHolders;
  const TimeUs began_us = steady_now_us();
  while (room == kEach * kHolders) loop.run_one();
  EXPECT_EQ(done, 1) << "of all that hold memory now";
  loop.run();
  EXPECT_EQ(done, kEach * kHolders);
  EXPECT_EQ(gone, 2);
  EXPECT_GE(steady_now_us() - began_us, 2 * kEach * kHolders * kUs - 15'000);
}

}  // namespace
}  // namespace eigencast::broker
