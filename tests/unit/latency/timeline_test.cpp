// SPDX-License-Identifier: MIT
#include "tools/latency/timeline.h"

#include <gtest/gtest.h>

namespace eigencast::latency {
namespace {

constexpr TimeUs kBrokerAhead = 7'000'000;   // Ahead of the sender's clock.
constexpr TimeUs kViewerBehind = 2'000'000;  // Behind the broker's.

TimeUs us(const StagedPose& pose, Stage stage) {
  return pose.stages[static_cast<std::size_t>(stage)].us;
}

/// Key `sequence` was meant for `capture` (sender's clock) and went through the stages in known times.
control::Trace senders(std::uint64_t sequence, TimeUs capture, TimeUs offset_found) {
  control::Trace t;
  t.sequence = sequence;
  t.stages = {{"started", capture + 10}, {"transformed", capture + 510}, {"sent", capture + 600}};
  t.broker_clock = {offset_found, 40};
  return t;
}

control::Trace brokers(std::uint64_t sequence, std::uint8_t step, TimeUs arrived, TimeUs due, TimeUs left) {
  control::Trace t;
  t.sequence = sequence;
  t.step = step;
  t.stages = {{"arrived", arrived + kBrokerAhead}, {"written", left + kBrokerAhead}};
  if (due != 0) t.stages.emplace_back("scheduled", due + kBrokerAhead);
  return t;
}

Received received(FrameKind kind, std::uint64_t sequence, InterpolationStep step, TimeUs capture, TimeUs read) {
  Received r;
  r.envelope.kind = kind;
  r.envelope.sequence = sequence;
  r.envelope.step = step;
  r.envelope.capture_us = capture;
  const TimeUs here = read + kBrokerAhead - kViewerBehind;
  r.read_us = here;
  r.decoded_us = here + 15;
  r.taken_us = here + 60;
  r.rebuilt_us = here + 460;
  r.presented_us = here + 460;
  r.clock = ViewerClock{kViewerBehind, 30};
  return r;
}

TEST(Timeline, StagesAddUpAcrossThreeClocks) {
  Timeline line({});
  line.add(received(FrameKind::kKey, 5, {}, 1'000'000, 1'001'000));
  EXPECT_TRUE(line.take().empty());
  line.add(brokers(5, 0, 1'000'800, 0, 1'000'850));
  line.add(senders(5, 1'000'000, kBrokerAhead));
  const auto poses = line.take();
  ASSERT_EQ(poses.size(), 1u);
  const StagedPose& p = poses[0];
  EXPECT_EQ(us(p, Stage::kSchedule), 10);
  EXPECT_EQ(us(p, Stage::kTransform), 500);
  EXPECT_EQ(us(p, Stage::kEncode), 90);
  EXPECT_EQ(us(p, Stage::kToBroker), 200);
  EXPECT_EQ(us(p, Stage::kHold), 0);
  EXPECT_EQ(us(p, Stage::kInBroker), 50);
  EXPECT_EQ(us(p, Stage::kToClient), 150);
  EXPECT_EQ(us(p, Stage::kDecode), 15);
  EXPECT_EQ(us(p, Stage::kHandOver), 45);
  EXPECT_EQ(us(p, Stage::kReconstruct), 400);
  EXPECT_EQ(p.total.us, 1460);
  EXPECT_EQ(p.unexplained_us(), 0);
  EXPECT_EQ(p.uncertainty_us(), 2 * (40 + 30));
}

TEST(Timeline, WrongOffsetIsUnexplainedTime) {
  Timeline line({true, false});
  Received r = received(FrameKind::kKey, 5, {}, 1'000'000, 1'001'000);
  r.read_us -= kBrokerAhead - kViewerBehind;
  r.decoded_us -= kBrokerAhead - kViewerBehind;
  r.taken_us -= kBrokerAhead - kViewerBehind;
  r.rebuilt_us -= kBrokerAhead - kViewerBehind;
  r.presented_us -= kBrokerAhead - kViewerBehind;
  r.clock = ViewerClock{kBrokerAhead + 500, 30};
  line.add(r);
  line.add(brokers(5, 0, 1'000'800, 0, 1'000'850));
  line.add(senders(5, 1'000'000, kBrokerAhead));
  const auto poses = line.take();
  ASSERT_EQ(poses.size(), 1u);
  EXPECT_EQ(poses[0].total.us, 1460);
  EXPECT_EQ(poses[0].unexplained_us(), -500);
  EXPECT_GT(std::abs(poses[0].unexplained_us()), poses[0].uncertainty_us());
}

TEST(Timeline, NegativeStagesAreKept) {
  Timeline line({});
  line.add(senders(5, 1'000'000, kBrokerAhead + 350));
  line.add(brokers(5, 0, 1'000'800, 0, 1'000'850));
  line.add(received(FrameKind::kKey, 5, {}, 1'000'000, 1'001'000));
  EXPECT_EQ(us(line.take().at(0), Stage::kToBroker), -150);
}

TEST(Timeline, NegativeStageBeyondClockErrorIsImpossible) {
  StagedPose pose;
  EXPECT_TRUE(pose.is_possible());
  pose.stages[static_cast<std::size_t>(Stage::kMargin)] = {-500, 0};
  EXPECT_TRUE(pose.is_possible()) << "the key came late";
  pose.stages[static_cast<std::size_t>(Stage::kToClient)] = {-30, 40};
  EXPECT_TRUE(pose.is_possible());
  pose.stages[static_cast<std::size_t>(Stage::kToClient)] = {-30, 20};
  EXPECT_FALSE(pose.is_possible());
}

TEST(Timeline, HoldIsEqualWithinAnInterval) {
  // Keys every 30 ms; the first pose of an interval can leave when its second key is there; the schedule has 4 ms of
  // margin, which the key that came 4 ms late used up.
  constexpr TimeUs kInterval = 30'000;
  Timeline line({});
  for (std::uint64_t s = 10; s < 20; ++s) {
    const TimeUs capture = static_cast<TimeUs>(s) * kInterval;
    const TimeUs late = s == 14 ? 4000 : 0;
    const TimeUs arrived = capture + 800 + late;
    line.add(senders(s, capture, kBrokerAhead));
    for (std::uint8_t at = 1; at <= 3; ++at) {
      const TimeUs media = capture - kInterval + kInterval * at / 3;
      const TimeUs due = media + 2 * kInterval / 3 + 800 + 4000;
      const InterpolationStep step = at == 3 ? InterpolationStep{} : InterpolationStep{at, 3};
      line.add(brokers(s, step.byte(), arrived, due, due + 70));
      line.add(received(at == 3 ? FrameKind::kKey : FrameKind::kStep, s, step, media, due + 200));
    }
  }
  const auto poses = line.take();
  ASSERT_EQ(poses.size(), 30u);
  for (const StagedPose& p : poses) {
    EXPECT_EQ(us(p, Stage::kInBroker), 70);
    EXPECT_EQ(p.unexplained_us(), 0);
    if (p.envelope.sequence == 10) continue;  // The key before it is not known.
    EXPECT_EQ(us(p, Stage::kHold), 2 * kInterval / 3);
    EXPECT_EQ(us(p, Stage::kMargin), p.envelope.sequence == 14 ? 0 : 4000);
  }
}

TEST(Timeline, IncompletePosesAreDroppedAndCounted) {
  Timeline line({});
  for (std::uint64_t s = 1; s <= 2000; ++s) {
    line.add(brokers(s, 0, 1000, 0, 1010));
    line.add(received(FrameKind::kKey, s, {}, 1000, 2000));
  }
  EXPECT_TRUE(line.take().empty());
  EXPECT_EQ(line.incomplete(), 2000u - 256u);
}

}  // namespace
}  // namespace eigencast::latency
