// SPDX-License-Identifier: MIT
#include "common/net/broker_order.h"

#include <gtest/gtest.h>

namespace eigencast {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kPause{1000}, kStep{10};

TEST(BrokerOrder, OnlyBrokerWaitsForItself) {
  BrokerOrder order(1);
  EXPECT_EQ(order.count_failure(), 1);
  EXPECT_EQ(order.go_on(5, kPause, kStep), kPause);
  EXPECT_EQ(order.count_failure(), 2);
  EXPECT_EQ(order.broker(), 0u);
}

TEST(BrokerOrder, NextIsTriedAtOnceUntilAllHaveFailed) {
  BrokerOrder order(3);
  for (const std::size_t next : {1u, 2u}) {
    EXPECT_EQ(order.count_failure(), 1);
    EXPECT_EQ(order.go_on(0, kPause, kStep), kStep);
    EXPECT_EQ(order.broker(), next);
  }
  EXPECT_EQ(order.count_failure(), 1);
  EXPECT_EQ(order.go_on(0, kPause, kStep), kPause);
  EXPECT_EQ(order.broker(), 0u) << "its time comes first";
  EXPECT_EQ(order.count_failure(), 2) << "each has its own back-off";
}

TEST(BrokerOrder, BrokerThatIsHeldOffComesLast) {
  BrokerOrder order(2);
  EXPECT_EQ(order.go_on(0, milliseconds(30'000), kStep), kStep);
  for (TimeUs now = 0; now < 20'000'000; now += 1'000'000) {
    EXPECT_EQ(order.broker(), 1u);
    EXPECT_EQ(order.go_on(now, kPause, kStep), kPause);
  }
  EXPECT_EQ(order.go_on(29'990'000, kPause, kStep), kStep);
  EXPECT_EQ(order.broker(), 0u);
}

TEST(BrokerOrder, GoodConnectionForgivesAllFailures) {
  BrokerOrder order(2);
  for (int i = 0; i < 9; ++i) {
    (void)order.count_failure();
    (void)order.go_on(i * 1'000'000'000LL, kPause, kStep);
  }
  order.forgive();
  EXPECT_EQ(order.count_failure(), 1);
}

}  // namespace
}  // namespace eigencast
