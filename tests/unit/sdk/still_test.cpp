// SPDX-License-Identifier: MIT
// A still surface is not sent: viewers in any mode stay within the bound all the same.
#include <gtest/gtest.h>

#include <cmath>
#include <thread>

#include "common/codec/key.h"
#include "common/surface/shapes/shapes.h"
#include "common/wire/control.h"
#include "sdk/bake.h"
#include "sdk/publisher.h"
#include "sdk/subscriber.h"
#include "tests/support/loopback_broker.h"

namespace eigencast {
namespace {

using testing::eventually;
using testing::LoopbackBroker;
using testing::milliseconds;

using Rate = Profile::Rate;
using Scheme = Profile::Scheme;

constexpr double kError = 0.002;
constexpr TimeUs kStillFrameUs = 20'000, kHeartbeatUs = 300'000;
constexpr int kMoves = 40, kStands = 70;

std::vector<double> pose(const Asset& asset, double phase) {
  std::vector<double> C = asset.rest;
  for (std::size_t j = 0; j < C.size(); ++j) C[j] += 0.05 * std::sin(phase + static_cast<double>(j));
  return C;
}

struct Watch {
  Profile profile;
  std::unique_ptr<Subscriber> subscriber;
  std::vector<ReceivedPose> poses;
};

TEST(Still, ShownPosesStayWithinTheBound) {
  BakeOptions bake_options;
  bake_options.rank = 40;
  auto baked = bake(make_icosphere(3), bake_options);
  ASSERT_TRUE(baked);
  const auto asset = std::make_shared<const Asset>(std::move(baked->asset));
  LoopbackBroker broker;
  PublisherOptions options;
  options.url = broker.url("still");
  options.error = kError;
  options.still_heartbeat_us = kHeartbeatUs;
  options.key_rate_hz = 1e6 / kStillFrameUs;
  auto publisher = Publisher::create(options, asset, std::make_shared<const EncodedAsset>(std::move(baked->encoded)));
  ASSERT_TRUE(publisher) << publisher.error().message;
  ASSERT_TRUE(eventually([&] { return (*publisher)->stats().state == Publisher::State::kLive; }));

  std::vector<Watch> watches;
  for (const Profile& profile :
       {Profile{Rate::kRaw}, Profile{}, Profile{Rate::kInterpolated, 4, 8, Scheme::kCatmullRom},
        Profile{Rate::kEstimated, 3, 8, Scheme::kDamped}, Profile{Rate::kEstimated, 3, 8, Scheme::kLinear}}) {
    auto subscriber = Subscriber::create({options.url, profile, {}});
    ASSERT_TRUE(subscriber) << subscriber.error().message;
    watches.push_back({profile, std::move(*subscriber), {}});
  }
  const auto collect = [&] {
    for (Watch& w : watches) {
      for (ReceivedPose& p : w.subscriber->poll(milliseconds(0))) w.poses.push_back(std::move(p));
    }
  };

  // It moves, stands still, and moves on.
  TimeUs held_from_us = 0, held_until_us = 0;
  std::uint64_t held_from = 0, sent_in_pause = 0;
  std::vector<double> before;
  for (int frame = 0; frame < 2 * kMoves + kStands; ++frame) {
    const int moved = frame < kMoves ? frame : frame < kMoves + kStands ? kMoves : frame - kStands;
    const TimeUs now = steady_now_us();
    const auto C = pose(*asset, 0.15 * moved);
    ASSERT_EQ((*publisher)->send_coefficients(C, now), SendStatus::kSent) << (*publisher)->stats().detail;
    const auto held = (*publisher)->as_received();
    if (held == before && held_from_us == 0) {
      held_from_us = now;
      held_from = (*publisher)->stats().frames_sent;
    }
    if (moved == kMoves && frame < kMoves + kStands) {
      held_until_us = now;
      sent_in_pause = (*publisher)->stats().frames_sent - held_from;
    }
    before = held;
    for (const TimeUs end = now + kStillFrameUs; steady_now_us() < end;) {
      collect();
      std::this_thread::sleep_for(milliseconds(2));
    }
  }
  for (int i = 0; i < 50; ++i) {
    collect();
    std::this_thread::sleep_for(milliseconds(5));
  }

  ASSERT_GT(held_from_us, 0);
  EXPECT_GT((*publisher)->stats().frames_held, static_cast<std::uint64_t>(kStands) / 2);
  EXPECT_GE(sent_in_pause, 2u) << "heartbeats";
  const auto truth = pose(*asset, 0.15 * kMoves);
  for (const Watch& w : watches) {
    std::size_t in_pause = 0, afterwards = 0;
    for (const ReceivedPose& p : w.poses) {
      // An estimate made before the pause was known of is a guess like any other.
      if (p.envelope.capture_us > held_until_us) ++afterwards;
      if (p.envelope.sequence < held_from || p.envelope.capture_us < held_from_us) continue;
      if (p.envelope.capture_us > held_until_us) continue;
      ++in_pause;
      EXPECT_LE(surface_distance(p.coefficients, truth, asset->area), kStillOverError * kError)
          << query_from_profile(w.profile) << " sequence " << p.envelope.sequence << " step " << int{p.envelope.step.at}
          << "/" << int{p.envelope.step.of} << ", " << p.envelope.capture_us - held_from_us << " us into the pause";
    }
    EXPECT_GE(in_pause, 3u) << query_from_profile(w.profile);
    EXPECT_GE(afterwards, 3u) << query_from_profile(w.profile);
  }
}

}  // namespace
}  // namespace eigencast
