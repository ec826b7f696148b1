// SPDX-License-Identifier: MIT
#include "common/command_line/log.h"

#include <gtest/gtest.h>

namespace eigencast {
namespace {

constexpr TimeUs kSecond = 1'000'000;

TEST(LogThrottle, FloodOfOneKindIsCountedAndHidesNoOther) {
  LogThrottle throttle;
  const auto flood = [&](TimeUs now_us) { return throttle.pass("from a peer", now_us); };
  const auto other = [&](TimeUs now_us) { return throttle.pass("of ours", now_us); };
  int passed = 0;
  for (int i = 0; i < 1000; ++i) passed += flood(i) ? 1 : 0;
  EXPECT_EQ(passed, 50);
  EXPECT_EQ(other(1000), std::optional<std::uint64_t>(0));
  EXPECT_FALSE(flood(9 * kSecond));
  EXPECT_EQ(flood(10 * kSecond), std::optional<std::uint64_t>(951));
  EXPECT_EQ(flood(10 * kSecond), std::optional<std::uint64_t>(0));
}

}  // namespace
}  // namespace eigencast
