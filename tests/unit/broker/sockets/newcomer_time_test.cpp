// SPDX-License-Identifier: MIT
#include "broker/sockets/newcomer_time.h"

#include <gtest/gtest.h>

#include <string>

namespace eigencast::broker {
namespace {

TEST(NewcomerTime, ACrowdTakesHalfOfTheLoopsTimeAndLeavesOthersTheirTurns) {
  asio::io_context loop;
  NewcomerTime time(loop);
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

}  // namespace
}  // namespace eigencast::broker
