// SPDX-License-Identifier: MIT
// Each of the three programs is killed and started again while the others run: they say what happened, reconnect and go
// on.
#include <gtest/gtest.h>

#include <csignal>

#include "tests/system/scene.h"

namespace eigencast::testing {
namespace {

class Restart : public ::testing::Test {
 protected:
  void SetUp() override {
    broker_ = scene_.start_broker();
    sender_ = scene_.start_sender({"torus", "--rate", "30"});
    client_ = scene_.start_client("a", kEndless);
    ASSERT_TRUE(grows()) << scene_.logs();
  }

  /// Ten more poses arrive at the viewer.
  bool grows() {
    const std::size_t before = scene_.received("a").size();
    return eventually([&] { return scene_.received("a").size() >= before + 10; }, kPatience);
  }

  static void kill(Process& process) {
    process.signal(SIGKILL);
    ASSERT_EQ(process.wait(kPatience), 128 + SIGKILL);
  }

  Scene scene_;
  std::unique_ptr<Process> broker_, sender_, client_;
};

TEST_F(Restart, ARestartedBrokerFindsBothAgain) {
  kill(*broker_);
  broker_ = scene_.start_broker();
  EXPECT_TRUE(grows()) << scene_.logs();
  EXPECT_TRUE(sender_->running());
  EXPECT_GE(scene_.reconnects("a", *client_), 1u) << scene_.logs();
}

TEST_F(Restart, ARestartedSenderResumesInTheSameViewer) {
  kill(*sender_);
  EXPECT_TRUE(client_->wait_for_output("stalled", kPatience)) << scene_.logs();
  sender_ = scene_.start_sender({"torus", "--rate", "30"});
  EXPECT_TRUE(grows()) << scene_.logs();
  EXPECT_TRUE(broker_->running());
}

TEST_F(Restart, AnotherSurfaceReachesTheRunningViewer) {
  const std::size_t rows = scene_.received("a").back().coefficients.size();
  kill(*sender_);
  sender_ = scene_.start_sender({"torus", "--rate", "30", "--rank", "60"});
  EXPECT_TRUE(eventually([&] { return scene_.received("a").back().coefficients.size() == 60 * 3; }, kPatience))
      << scene_.logs();
  EXPECT_NE(rows, 60u * 3u);
  EXPECT_TRUE(grows()) << scene_.logs();
}

TEST_F(Restart, ARestartedViewerDisturbsNoOther) {
  auto other = scene_.start_client("b", kEndless);
  ASSERT_TRUE(eventually([&] { return scene_.received("b").size() >= 5; }, kPatience)) << scene_.logs();
  kill(*other);
  EXPECT_TRUE(grows()) << scene_.logs();
  other = scene_.start_client("c", {"--frames", "5"});
  EXPECT_EQ(other->wait(kPatience), 0) << scene_.logs();
  EXPECT_EQ(scene_.reconnects("a", *client_), 0u) << scene_.logs();
}

TEST_F(Restart, EveryProgramEndsCleanlyOnSigterm) {
  for (Process* process : {client_.get(), sender_.get(), broker_.get()}) {
    process->signal(SIGTERM);
    EXPECT_EQ(process->wait(kPatience), 0) << scene_.logs();
  }
}

TEST_F(Restart, AnEarlyViewerWaitsForItsSender) {
  kill(*sender_);
  kill(*broker_);
  auto early = scene_.start_client("early", {"--frames", "5"});
  EXPECT_TRUE(early->wait_for_output("next try in", kPatience)) << scene_.logs();
  broker_ = scene_.start_broker();
  EXPECT_TRUE(early->wait_for_output("waiting", kPatience)) << scene_.logs();
  sender_ = scene_.start_sender({"torus", "--rate", "30"});
  EXPECT_EQ(early->wait(kPatience), 0) << scene_.logs();
}

}  // namespace
}  // namespace eigencast::testing
