// SPDX-License-Identifier: MIT
// A publisher that remembers what comes again, against a whole broker in this process.
#include <gtest/gtest.h>

#include <numbers>

#include "tests/unit/sdk/ball_stream.h"

namespace eigencast {
namespace {

constexpr int kLoopPoses = 48;
constexpr int kLooperRank = 40;

/// Pose i of a motion that comes again after kLoopPoses poses.
std::vector<double> loop_pose(const Asset& asset, int i) {
  std::vector<double> C = asset.rest;
  for (std::size_t j = 12; j < C.size(); ++j) {
    for (int wave = 1; wave <= 8; ++wave)
      C[j] +=
          0.02 * std::sin(2 * std::numbers::pi * wave * i / kLoopPoses + static_cast<double>(j * j % 31 + j) * wave);
  }
  return C;
}

/// Sends the loop, and keeps what receivers are to show.
class Looper {
 public:
  explicit Looper(const LoopbackBroker& broker, MemoryUse memory = MemoryUse::kAuto) {
    PublisherOptions options;
    options.url = broker.url("live/ball");
    options.memory = memory;
    auto made = Publisher::create(options, model(kLooperRank).asset, model(kLooperRank).encoded);
    EXPECT_TRUE(made) << made.error().message;
    publisher = std::move(*made);
  }
  void send() {
    const TimeUs now = steady_now_us();
    if (now - last_us_ < 5000) return;
    if (publisher->send_coefficients(loop_pose(*model(kLooperRank).asset, count_++), now) != SendStatus::kSent) return;
    last_us_ = now;
    received[now] = publisher->as_received();
  }
  /// Sends until `done`, and holds what arrives against what was sent.
  template <typename Done>
  bool exchange(Subscriber& viewer, Done done) {
    return eventually([&] {
      send();
      for (const ReceivedPose& pose : viewer.poll(milliseconds(5))) {
        const auto sent = received.find(pose.envelope.capture_us);
        if (sent == received.end()) continue;  // Of the sender before.
        // The broker codes keys anew until it knows that the viewer has the memory.
        double most = 0;
        for (std::size_t i = 0; i < sent->second.size(); ++i)
          most = std::max(most, std::abs(pose.coefficients[i] - sent->second[i]));
        EXPECT_LE(most, pose.envelope.is_recalled() ? 0 : 0.03);
        checked += pose.envelope.is_recalled() ? 1 : 0;
      }
      return done(publisher->stats());
    });
  }
  std::unique_ptr<Publisher> publisher;
  std::map<TimeUs, std::vector<double>> received;
  int checked = 0;

 private:
  int count_ = 0;
  TimeUs last_us_ = 0;
};

TEST(MemoryUse, MotionThatComesAgainIsSentFromMemoryAcrossRestarts) {
  LoopbackBroker broker;
  auto viewer = subscribe(broker);
  auto looper = std::make_unique<Looper>(broker);
  const auto recalls = [&](std::uint64_t more) {
    const std::uint64_t before = looper->publisher->stats().frames_recalled;
    const int checked = looper->checked;
    return looper->exchange(*viewer, [&](const Publisher::Stats& stats) {
      return stats.frames_recalled >= before + more && looper->checked > checked + 20;
    });
  };
  ASSERT_TRUE(recalls(200)) << looper->publisher->memory().refused.value_or(Error{}).message;
  const Publisher::Stats stats = looper->publisher->stats();
  EXPECT_GT(stats.memory_bytes, 0u);
  EXPECT_GT(stats.saved_bytes, 0u);

  broker.stop();
  broker.start();
  ASSERT_TRUE(recalls(200)) << "the broker was given the memory again";
  EXPECT_GE(looper->publisher->stats().reconnects, 1u);

  looper.reset();
  looper = std::make_unique<Looper>(broker);
  ASSERT_TRUE(recalls(100)) << "another sender of the surface";
}

TEST(MemoryUse, NothingIsRememberedWhereItIsOff) {
  LoopbackBroker broker;
  auto viewer = subscribe(broker);
  Looper looper(broker, MemoryUse::kOff);
  ASSERT_TRUE(looper.exchange(*viewer, [&](const Publisher::Stats& stats) { return stats.frames_sent > 700; }));
  EXPECT_EQ(looper.publisher->stats().frames_recalled, 0u);
  EXPECT_EQ(looper.publisher->stats().memory_bytes, 0u);
  EXPECT_FALSE(looper.publisher->memory().pending);
}

}  // namespace
}  // namespace eigencast
