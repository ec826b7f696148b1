// SPDX-License-Identifier: MIT
#include "broker/operation/logger.h"

#include <gtest/gtest.h>

namespace eigencast::broker {
namespace {

TEST(LogThrottleTest, LimitsEachKindAndCountsOmitted) {
  LogThrottle throttle({3, 1000, 10});
  for (int i = 0; i < 3; ++i) EXPECT_EQ(throttle.admit("client " + std::to_string(i) + " failed", i), 0u);
  for (int i = 3; i < 50; ++i) EXPECT_FALSE(throttle.admit("client " + std::to_string(i) + " failed", i));
  EXPECT_EQ(throttle.admit("something else", 50), 0u);
  EXPECT_EQ(throttle.admit("client 1234 failed", 1000), 47u);
  EXPECT_EQ(throttle.admit("client 1235 failed", 1001), 0u);
}

TEST(LogThrottleTest, KindsAreBounded) {
  LogThrottle throttle({1, 1'000'000, 4});
  EXPECT_TRUE(throttle.admit("a", 0));
  for (char c = 'b'; c < 'z'; ++c) EXPECT_TRUE(throttle.admit(std::string(3, c), c));
  EXPECT_TRUE(throttle.admit("a", 200)) << "forgotten meanwhile";
  EXPECT_FALSE(throttle.admit("a", 201));
}

}  // namespace
}  // namespace eigencast::broker
