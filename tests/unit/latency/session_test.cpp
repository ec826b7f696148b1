// SPDX-License-Identifier: MIT
#include "tools/latency/session.h"

#include <gtest/gtest.h>

#include "tests/support/impaired_relay.h"
#include "tests/support/loopback_broker.h"

namespace eigencast::latency {
namespace {

using testing::ImpairedRelay;
using testing::LoopbackBroker;

const std::atomic<bool> never{false};

/// Short runs of a small surface: what is asserted does not depend on how fast the machine is.
Inputs quick(const LoopbackBroker& broker) {
  Inputs in;
  in.url = broker.url("test");
  in.source = "torus";
  in.rank = 24;
  in.duration_s = 0.8;
  in.warmup_s = 1.2;  // The broker asks the sender for traces within a second.
  return in;
}

/// The other end, for so long.
std::thread publishes(const LoopbackBroker& broker, double seconds) {
  Inputs in = quick(broker);
  in.mode = "publish";
  in.duration_s = seconds;
  in.warmup_s = 0;
  return std::thread([in] { EXPECT_TRUE(run_session(in, never, {}, {})); });
}

TEST(Session, StagesOfEveryPoseAddUp) {
  LoopbackBroker broker;
  const auto o = run_session(quick(broker), never, {}, {});
  ASSERT_TRUE(o) << o.error().message;
  EXPECT_GT(o->counts.keys_received, 5u);
  EXPECT_EQ(o->keys.count(), o->counts.keys_received);
  EXPECT_EQ(o->keys.negative(), 0u);
  EXPECT_GT(o->counts.traced, 5u);
  EXPECT_EQ(o->sums_checked, o->counts.traced);
  EXPECT_EQ(o->sums_wrong, 0u);
  EXPECT_EQ(o->worst_unexplained_us, 0) << "one machine, one clock";
  EXPECT_EQ(o->impossible, 0u);
  EXPECT_TRUE(o->whole_asset_us);
  EXPECT_EQ(o->counts.duplicate, 0u);
  EXPECT_TRUE(o->first_surface_us);
  for (std::size_t i = 0; i < kStages; ++i)
    EXPECT_EQ(o->key_stages[i].negative(), 0u) << name_of(static_cast<Stage>(i));
}

TEST(Session, InterpolationHoldsTwoThirdsOfAnInterval) {
  LoopbackBroker broker;
  Inputs in = quick(broker);
  in.interpolation = 3;
  const auto o = run_session(in, never, {}, {});
  ASSERT_TRUE(o) << o.error().message;
  EXPECT_GT(o->counts.synthetic_received, o->counts.keys_received);
  EXPECT_GT(o->synthetic_totals.count(), 5u);
  EXPECT_EQ(o->sums_wrong, 0u);
  const double interval_us = 1e6 / in.rate_hz;
  const HdrHistogram& hold_us = o->synthetic_stages[static_cast<std::size_t>(Stage::kHold)];
  EXPECT_NEAR(static_cast<double>(hold_us.percentile(50)), 2 * interval_us / 3, 0.05 * interval_us);
  EXPECT_GE(static_cast<double>(o->held_us.percentile(50)), 2 * interval_us / 3 * 0.999) << "nothing is held for less";
}

/// The tool against a known delay: what a link adds, the tool reads, beside a run without the link on the same machine.
TEST(Session, LinkDelayIsMeasured) {
  LoopbackBroker broker;
  ImpairedRelay::Options link;
  link.target_port = broker.port();
  link.from_target.delay_us = 25'000;
  auto relay = ImpairedRelay::start(link);
  ASSERT_TRUE(relay) << relay.error().message;
  Inputs in = quick(broker);
  const auto without = run_session(in, never, {}, {});
  in.viewer_url = (*relay)->url("test");
  const auto with = run_session(in, never, {}, {});
  ASSERT_TRUE(without && with);
  ASSERT_GT(without->keys.count(), 5u);
  ASSERT_GT(with->keys.count(), 5u);
  const auto to_client = [](const Outcome& o) {
    return o.key_stages[static_cast<std::size_t>(Stage::kToClient)].percentile(50);
  };
  // The relay adds its two hops and wake-ups; a loaded machine makes those milliseconds. It cannot make them less.
  EXPECT_NEAR(static_cast<double>(to_client(*with) - to_client(*without)), 25'000, 5'000);
  EXPECT_GE(with->keys.min(), 25'000);
  EXPECT_EQ(with->sums_wrong, 0u);
  const auto clock = with->viewer_clock.best();
  ASSERT_TRUE(clock);
  EXPECT_GE(clock->error_us, 12'500) << "an asymmetry of 25 ms cannot be seen: the bound must allow for it";
  EXPECT_LE(std::abs(clock->offset_us), clock->error_us);
}

TEST(Session, LightViewersAreCounted) {
  LoopbackBroker broker;
  Inputs in = quick(broker);
  in.clients = 41;
  const auto o = run_session(in, never, {}, {});
  ASSERT_TRUE(o) << o.error().message;
  ASSERT_TRUE(o->load);
  EXPECT_EQ(o->load->viewers, 40u);
  EXPECT_EQ(o->load->refused, 0u);
  EXPECT_EQ(o->load->undecodable, 0u);
  EXPECT_GT(o->load->frames, 40u * 5u);
  EXPECT_GT(o->load->latency_us.count(), 40u * 5u);
}

TEST(Session, PairMeasuresByClockOffsets) {
  LoopbackBroker broker;
  std::thread sender = publishes(broker, 4);
  Inputs watches = quick(broker);
  watches.mode = "passive";
  const auto o = run_session(watches, never, {}, {});
  sender.join();
  ASSERT_TRUE(o) << o.error().message;
  EXPECT_FALSE(o->one_clock);
  EXPECT_GT(o->counts.traced, 5u);
  EXPECT_EQ(o->keys.count() + o->keys.negative(), o->counts.traced);
  EXPECT_EQ(o->sums_wrong, 0u);
  EXPECT_GT(o->total_error_us, 0);
}

/// The link breaks in the middle of the run and comes back: a viewer that does not know what was sent goes by the
/// numbers of the keys.
TEST(Session, PairCountsLostKeys) {
  LoopbackBroker broker;
  std::thread sender = publishes(broker, 5);
  ImpairedRelay::Options link;
  link.target_port = broker.port();
  auto relay = ImpairedRelay::start(link);
  ASSERT_TRUE(relay) << relay.error().message;
  link.port = (*relay)->port();
  Inputs watches = quick(broker);
  watches.mode = "passive";
  watches.url = (*relay)->url("test");
  watches.warmup_s = 0.3;
  watches.duration_s = 3;
  std::thread breaks([&] {
    testing::sleep_for(testing::milliseconds(1300));
    relay->reset();
    testing::sleep_for(testing::milliseconds(300));
    relay = ImpairedRelay::start(link);
    EXPECT_TRUE(relay) << relay.error().message;
  });
  const auto o = run_session(watches, never, {}, {});
  breaks.join();
  sender.join();
  ASSERT_TRUE(o) << o.error().message;
  EXPECT_GT(o->counts.keys_received, 5u);
  EXPECT_GT(o->counts.keys_lost, 5u) << "300 ms are nine keys";
}

/// The link breaks for good in the middle of the run.
TEST(Session, EndsByDeadlineAndCountsLostFrames) {
  LoopbackBroker broker;
  ImpairedRelay::Options link;
  link.target_port = broker.port();
  auto relay = ImpairedRelay::start(link);
  ASSERT_TRUE(relay) << relay.error().message;
  Inputs in = quick(broker);
  in.viewer_url = (*relay)->url("test");
  in.warmup_s = 1.5;
  in.duration_s = 2;
  const TimeUs start_us = steady_now_us();
  std::thread breaks([&] {
    testing::sleep_for(testing::milliseconds(2700));
    relay->reset();
  });
  const auto o = run_session(in, never, {}, {});
  const TimeUs took_us = steady_now_us() - start_us;
  breaks.join();
  ASSERT_TRUE(o) << o.error().message;
  EXPECT_GT(o->counts.keys_lost, 5u);
  EXPECT_EQ(o->counts.keys_lost + o->counts.keys_received, o->counts.keys_sent);
  EXPECT_LT(took_us, 15'000'000) << "a connection that nobody answers must not hold it up";
}

TEST(Session, PictureIsAStageOfTheTotal) {
  LoopbackBroker broker;
  Inputs in = quick(broker);
  in.present = "160x120";
  in.rate_hz = 10;  // Slow processors draw it.
  const auto o = run_session(in, never, {}, {});
  if (!o && o.error().code == ErrorCode::kUnsupported) GTEST_SKIP() << "NO PICTURES HERE: " << o.error().message;
  ASSERT_TRUE(o) << o.error().message;
  EXPECT_FALSE(o->device.empty());
  ASSERT_GT(o->counts.traced, 0u);
  EXPECT_GT(o->key_stages[static_cast<std::size_t>(Stage::kPresent)].min(), 0);
  EXPECT_EQ(o->sums_wrong + o->impossible, 0u);
  EXPECT_TRUE(o->first_picture_us && o->first_surface_us && *o->first_picture_us > *o->first_surface_us);
  EXPECT_GT(o->age_us.mean(), static_cast<double>(o->keys.min())) << "a pose ages while it is shown";
}

TEST(Session, PicturesOfNoSizeAreRefused) {
  LoopbackBroker broker;
  Inputs in = quick(broker);
  for (const char* size : {"big", "0x5", "10x10x10", "99999x2"}) {
    in.present = size;
    const auto o = run_session(in, never, {}, {});
    EXPECT_FALSE(o) << size;
  }
}

TEST(Session, EndsThoughNothingComes) {
  LoopbackBroker broker;
  Inputs in = quick(broker);
  in.mode = "passive";
  std::atomic<bool> stop{false};
  std::thread interrupt([&] {
    testing::sleep_for(testing::milliseconds(200));
    stop = true;
  });
  const auto o = run_session(in, stop, {}, {});
  interrupt.join();
  EXPECT_TRUE(!o || o->keys.count() == 0);
}

}  // namespace
}  // namespace eigencast::latency
