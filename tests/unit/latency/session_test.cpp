// SPDX-License-Identifier: MIT
#include "tools/latency/session.h"

#include <gtest/gtest.h>

#include <functional>
#include <memory>
#include <optional>
#include <thread>

#include "tests/support/impaired_relay.h"
#include "tests/support/loopback_broker.h"

namespace eigencast::latency {
namespace {

using testing::ImpairedRelay;
using testing::LoopbackBroker;

const std::atomic<bool> never{false};

/// Runs of a small surface, which end by counts: what is asserted does not depend on how fast the machine is.
Inputs quick(const LoopbackBroker& broker) {
  Inputs in;
  in.url = broker.url("test");
  in.source = "torus";
  in.rank = 24;
  in.duration_s = 60;
  in.warmup_s = 0;
  return in;
}

/// A link to the broker that the test may break.
std::unique_ptr<ImpairedRelay> relay_to(const LoopbackBroker& broker, ImpairedRelay::Options link = {}) {
  link.target_port = broker.port();
  return ImpairedRelay::start(link).value();
}

/// Runs until `enough` says so, at most for the duration.
Result<Outcome> run_until(const Inputs& in, const std::function<bool(const Progress&)>& enough) {
  std::atomic<bool> stop{false};
  return run_session(in, stop, [&](const Progress& p) { stop = stop || enough(p); }, {});
}

bool many_traced(const Progress& p) {
  return p.keys >= 24 && p.traced >= 24;
}

/// The other end, as long as it lives.
class Publishing {
 public:
  explicit Publishing(const LoopbackBroker& broker) {
    Inputs in = quick(broker);
    in.mode = "publish";
    thread_ = std::thread([this, in] {
      EXPECT_TRUE(run_until(in, [this](const Progress& p) {
        sent_ = p.sent;
        return stopping_.load();
      }));
    });
  }
  ~Publishing() {
    stopping_ = true;
    thread_.join();
  }
  std::uint64_t sent() const { return sent_; }

 private:
  std::atomic<bool> stopping_{false};
  std::atomic<std::uint64_t> sent_{0};
  std::thread thread_;
};

TEST(Session, StagesOfEveryPoseAddUp) {
  LoopbackBroker broker;
  const auto o = run_until(quick(broker), many_traced);
  ASSERT_TRUE(o) << o.error().message;
  EXPECT_GE(o->counts.keys_received, 24u);
  EXPECT_EQ(o->keys.count(), o->counts.keys_received);
  EXPECT_EQ(o->keys.negative(), 0u);
  EXPECT_GE(o->counts.traced, 24u);
  EXPECT_EQ(o->sums_checked, o->counts.traced);
  EXPECT_EQ(o->sums_wrong, 0u);
  EXPECT_EQ(o->worst_unexplained_us, 0) << "one machine, one clock";
  EXPECT_EQ(o->impossible, 0u);
  EXPECT_TRUE(o->whole_asset_us);
  EXPECT_EQ(o->counts.duplicate, 0u);
  EXPECT_TRUE(o->first_surface_us);
  for (std::size_t i = 0; i < kStages; ++i)
    EXPECT_EQ(o->key_stages[i].negative(), 0u) << kStageNames[static_cast<Stage>(i)];
}

TEST(Session, InterpolationHoldsTwoThirdsOfAnInterval) {
  LoopbackBroker broker;
  Inputs in = quick(broker);
  in.interpolation = 3;
  const auto o = run_until(in, many_traced);
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
  link.from_target.delay_us = 25'000;
  const auto relay = relay_to(broker, link);
  Inputs in = quick(broker);
  const auto without = run_until(in, many_traced);
  in.viewer_url = relay->url("test");
  const auto with = run_until(in, many_traced);
  ASSERT_TRUE(without && with);
  ASSERT_GE(without->keys.count(), 24u);
  ASSERT_GE(with->keys.count(), 24u);
  // The fastest key of many: the relay adds its two hops and wake-ups, which a loaded machine makes slow for most.
  const auto to_client = [](const Outcome& o) {
    return o.key_stages[static_cast<std::size_t>(Stage::kToClient)].min();
  };
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
  const auto o = run_until(in, [](const Progress& p) { return p.keys >= 30; });
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
  const Publishing sender(broker);
  Inputs watches = quick(broker);
  watches.mode = "passive";
  const auto o = run_until(watches, many_traced);
  ASSERT_TRUE(o) << o.error().message;
  EXPECT_FALSE(o->one_clock);
  EXPECT_GE(o->counts.traced, 24u);
  EXPECT_EQ(o->keys.count() + o->keys.negative(), o->counts.traced);
  EXPECT_EQ(o->sums_wrong, 0u);
  EXPECT_GT(o->total_error_us, 0);
}

/// The link breaks in the middle of the run and comes back: a viewer that does not know what was sent goes by the
/// numbers of the keys.
TEST(Session, PairCountsLostKeys) {
  LoopbackBroker broker;
  const Publishing sender(broker);
  auto relay = relay_to(broker);
  ImpairedRelay::Options again;
  again.port = relay->port();
  Inputs watches = quick(broker);
  watches.mode = "passive";
  watches.url = relay->url("test");
  std::optional<std::uint64_t> sent_at_break, received_at_repair;
  const auto o = run_until(watches, [&](const Progress& p) {
    if (!sent_at_break && p.keys >= 6) {
      relay.reset();
      sent_at_break = sender.sent();
    } else if (sent_at_break && !received_at_repair && sender.sent() >= *sent_at_break + 30) {
      relay = relay_to(broker, again);
      received_at_repair = p.keys;
    }
    return received_at_repair && p.keys >= *received_at_repair + 6;
  });
  ASSERT_TRUE(o) << o.error().message;
  EXPECT_GE(o->counts.keys_received, 12u);
  EXPECT_GT(o->counts.keys_lost, 5u) << "thirty were sent meanwhile";
}

/// The link breaks for good in the middle of the run.
TEST(Session, CountsWhatABrokenLinkLoses) {
  LoopbackBroker broker;
  auto relay = relay_to(broker);
  Inputs in = quick(broker);
  in.viewer_url = relay->url("test");
  std::optional<std::uint64_t> sent_at_break;
  const auto o = run_until(in, [&](const Progress& p) {
    if (!sent_at_break && p.keys >= 6) {
      relay.reset();
      sent_at_break = p.sent;
    }
    return sent_at_break && p.sent >= *sent_at_break + 20;
  });
  ASSERT_TRUE(o) << o.error().message;
  EXPECT_GT(o->counts.keys_lost, 5u);
  // On a starved machine newer poses supersede others before the break.
  const auto& counts = o->counts;
  const auto missing = counts.keys_sent - counts.keys_received;
  EXPECT_EQ(counts.keys_lost, missing - std::min(missing, counts.superseded + counts.overtaken));
}

/// A connection that nobody answers must not hold the run up; one that did would meet the timeout of the test.
TEST(Session, EndsByItsDeadlineWithoutALink) {
  LoopbackBroker broker;
  auto relay = relay_to(broker);
  Inputs in = quick(broker);
  in.viewer_url = relay->url("test");
  in.duration_s = 1;
  const auto o = run_session(in, never, [&](const Progress&) { relay.reset(); }, {});
  ASSERT_TRUE(o) << o.error().message;
  EXPECT_EQ(o->counts.keys_lost + o->counts.keys_received, o->counts.keys_sent);
}

TEST(Session, PictureIsAStageOfTheTotal) {
  LoopbackBroker broker;
  Inputs in = quick(broker);
  in.present = "160x120";
  in.rate_hz = 10;  // Slow processors draw it.
  const auto o = run_until(in, [](const Progress& p) { return p.traced >= 4; });
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
