// SPDX-License-Identifier: MIT
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "common/surface/shapes/shapes.h"
#include "sdk/bake.h"
#include "sdk/publisher.h"
#include "sdk/subscriber.h"
#include "tests/support/loopback_broker.h"

/// A ball that wobbles, sent to a broker in this process and watched.
namespace eigencast {

using testing::eventually;
using testing::LoopbackBroker;
using testing::milliseconds;

struct Model {
  std::shared_ptr<const Asset> asset;
  std::shared_ptr<const EncodedAsset> encoded;
};

/// An icosphere of 642 vertices; each rank is another asset.
inline const Model& model(int rank) {
  static std::map<int, Model> models;
  Model& m = models[rank];
  if (!m.asset) {
    auto baked = bake(make_icosphere(3), {.basis = BasisKind::kAugmented, .rank = rank, .name = "ball"});
    EXPECT_TRUE(baked) << baked.error().message;
    m = {std::make_shared<const Asset>(std::move(baked->asset)),
         std::make_shared<const EncodedAsset>(std::move(baked->encoded))};
  }
  return m;
}

/// Pose i: the rest pose, wobbling.
inline std::vector<double> pose(const Asset& asset, int i) {
  std::vector<double> C = asset.rest;
  for (std::size_t j = 12; j < C.size(); ++j) C[j] += 0.05 * std::sin(0.1 * i + static_cast<double>(j));
  return C;
}

/// Eq. 7 of the paper.
inline std::vector<double> straight_between(const std::vector<double>& a, const std::vector<double>& b, double u) {
  std::vector<double> result(a.size());
  for (std::size_t i = 0; i < a.size(); ++i) result[i] = a[i] + u * (b[i] - a[i]);
  return result;
}

/// Sends pose after pose, whenever it is asked to.
class Sender {
 public:
  Sender(const LoopbackBroker& broker, int rank, CodecKind codec = CodecKind::kFloat64,
         const std::string& stream = "live/ball")
      : Sender(broker.url(stream), rank, codec) {}
  Sender(const std::string& url, int rank, CodecKind codec) : model_(model(rank)) {
    PublisherOptions options;
    options.url = url;
    options.codec = codec;
    options.memory = MemoryUse::kOff;  // Tests remember what they want themselves.
    auto made = Publisher::create(std::move(options), model_.asset, model_.encoded);
    EXPECT_TRUE(made) << made.error().message;
    publisher = std::move(*made);
  }
  /// Sends the next pose; true if it left. Capture times are real: the broker's pacing follows them.
  bool send() {
    const TimeUs now = steady_now_us();
    if (now <= last_us_) return false;
    const auto C = pose(*model_.asset, count_);
    if (publisher->send_coefficients(C, now) != SendStatus::kSent) return false;
    last_us_ = now;
    ++count_;
    sent[now] = C;
    received[now] = publisher->as_received();
    return true;
  }
  bool send_first() {
    return eventually([&] { return send(); });
  }
  std::unique_ptr<Publisher> publisher;
  std::map<TimeUs, std::vector<double>> sent;
  std::map<TimeUs, std::vector<double>> received;  ///< What the publisher says that receivers decode.

 private:
  Model model_;
  int count_ = 0;
  TimeUs last_us_ = 0;
};

inline std::unique_ptr<Subscriber> subscribe(const LoopbackBroker& broker,
                                             Profile profile = {.rate = Profile::Rate::kRaw}, std::string cache = {}) {
  auto made = Subscriber::create({broker.url("live/ball"), profile, std::move(cache)});
  EXPECT_TRUE(made) << made.error().message;
  return std::move(*made);
}

/// Sends a pose every few milliseconds and polls until `enough` poses came.
inline std::vector<ReceivedPose> exchange(Sender& sender, Subscriber& subscriber, std::size_t enough,
                                          milliseconds gap = milliseconds(8)) {
  std::vector<ReceivedPose> all;
  eventually([&] {
    (void)sender.send();
    const auto until = std::chrono::steady_clock::now() + gap;
    do {
      for (ReceivedPose& p : subscriber.poll(milliseconds(2))) all.push_back(std::move(p));
    } while (std::chrono::steady_clock::now() < until);
    return all.size() >= enough;
  });
  return all;
}

}  // namespace eigencast
