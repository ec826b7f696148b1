// SPDX-License-Identifier: MIT
#include "tools/latency/load.h"

#include <gtest/gtest.h>

#include "tests/support/loopback_broker.h"

namespace eigencast::latency {
namespace {

TEST(Load, ViewersConnectAndWait) {
  testing::LoopbackBroker broker;
  auto load = Load::start({broker.url("nobody"), 100}, 10'000'000);
  ASSERT_TRUE(load) << load.error().message;
  const Load::Figures figures = (*load)->finish();
  EXPECT_EQ(figures.viewers, 100u);
  EXPECT_EQ(figures.frames, 0u);
}

TEST(Load, UnreachableAndUnusableUrlsAreErrors) {
  EXPECT_FALSE(Load::start({"what", 1}, 100'000));
  testing::LoopbackBroker broker;
  const std::string url = broker.url("x");
  broker.stop();
  EXPECT_FALSE(Load::start({url, 5}, 1'000'000));
}

TEST(Load, SpeaksNoTlsAndSaysSo) {
  const auto load = Load::start({"wss://127.0.0.1:1/x", 5}, 1'000'000);
  ASSERT_FALSE(load);
  EXPECT_EQ(load.error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(Load::start({"ws://127.0.0.1:1/x", 5, {}, {"two words"}}, 1'000'000).error().code,
            ErrorCode::kInvalidArgument);
}

TEST(Load, ReportsItsThreadAsBottleneck) {
  Load::Figures figures;
  EXPECT_FALSE(figures.was_bottleneck());
  figures.cpu_share = 0.9;
  EXPECT_TRUE(figures.was_bottleneck());
  figures.cpu_share = 0.1;
  for (int i = 0; i < 100; ++i) figures.lag_us.add(50'000);
  EXPECT_TRUE(figures.was_bottleneck());
}

}  // namespace
}  // namespace eigencast::latency
