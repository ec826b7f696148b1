// SPDX-License-Identifier: MIT
#include "broker/relay/outbox.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <deque>
#include <map>
#include <random>

namespace eigencast::broker {
namespace {

FramePtr frame(FrameKind kind, std::uint64_t sequence, InterpolationStep step = {}, std::uint8_t flags = 0) {
  Envelope head;
  head.flags = flags;
  head.kind = kind;
  head.sequence = sequence;
  head.step = step;
  head.bands = kind == FrameKind::kStep ? 0 : 1;
  const ChainClock newest;
  return make_frame(head, &newest, {});
}

Outbox::Text text(const std::string& content) {
  return std::make_shared<const std::string>(content);
}

class OutboxTest : public ::testing::Test {
 protected:
  OutboxTest() { outbox_.open_lane(1); }
  /// What leaves at `now_`: its sequence, negative for joins; nothing if nothing does.
  std::optional<int> take() {
    const auto item = outbox_.take(now_, [&](std::uint32_t) { return join_; });
    if (!item || !item->frame) return std::nullopt;
    const auto sequence = static_cast<int>(item->frame->envelope.sequence);
    return item->frame->envelope.kind == FrameKind::kJoin ? -sequence : sequence;
  }
  void join_at(std::uint64_t sequence) { join_ = frame(FrameKind::kJoin, sequence); }
  void offer_key(std::uint64_t sequence) {
    join_at(sequence);
    outbox_.offer(1, frame(FrameKind::kKey, sequence));
  }

  /// `shows`: this step; {0, 0}: nothing.
  void offer_ahead(std::uint64_t sequence, InterpolationStep shows = {}) {
    join_ = frame(FrameKind::kJoin, sequence, shows, Envelope::kAhead);
    outbox_.offer(1, frame(FrameKind::kKey, sequence, shows, Envelope::kAhead));
  }

  Outbox outbox_;
  FramePtr join_;
  TimeUs now_ = 0;
};

TEST_F(OutboxTest, JoinComesFirstThenKeys) {
  join_at(5);
  EXPECT_EQ(take(), -5);
  EXPECT_EQ(take(), std::nullopt);
  for (int s = 6; s < 10; ++s) {
    offer_key(static_cast<std::uint64_t>(s));
    EXPECT_EQ(take(), s);
    EXPECT_EQ(take(), std::nullopt);
  }
  EXPECT_EQ(outbox_.dropped_total(), 0u);
  EXPECT_EQ(outbox_.joins_total(), 1u);
}

// Late to be written, and found closed by then: what did not leave keeps no window closed.
TEST_F(OutboxTest, WhatWasNotWrittenOpensItsWindow) {
  join_at(1);
  EXPECT_EQ(take(), -1);
  outbox_.acknowledge({1, 1, 0}, now_ += 1'000);
  Envelope head = frame(FrameKind::kKey, 2)->envelope;
  head.stream_id = 1;
  const ChainClock newest;
  const FramePtr unsent = make_frame(head, &newest, {});
  outbox_.offer(1, unsent);
  EXPECT_EQ(take(), 2);
  now_ += 200'000;
  offer_key(3);
  EXPECT_EQ(take(), std::nullopt);
  outbox_.drop_unsent(unsent);
  EXPECT_EQ(take(), -3);
}

TEST_F(OutboxTest, NothingIsSentBeforeFirstKey) {
  EXPECT_EQ(take(), std::nullopt);
  join_at(1);
  outbox_.offer(1, join_);
  EXPECT_EQ(take(), -1);
}

TEST_F(OutboxTest, LatestFrameWinsAndJoinHealsGap) {
  join_at(1);
  take();
  for (int s = 2; s <= 100; ++s) offer_key(static_cast<std::uint64_t>(s));
  EXPECT_EQ(take(), -100) << "no backlog";
  EXPECT_EQ(take(), std::nullopt) << "the join holds key 100";
  offer_key(101);
  EXPECT_EQ(take(), 101);
  EXPECT_EQ(outbox_.dropped_total(), 98u);
  ASSERT_EQ(outbox_.take_dropped(8).size(), 1u);
  EXPECT_TRUE(outbox_.take_dropped(8).empty());
}

TEST_F(OutboxTest, SkippedStepNeedsNoJoin) {
  join_at(1);
  take();
  outbox_.offer(1, frame(FrameKind::kEstimate, 1, {1, 3}));
  outbox_.offer(1, frame(FrameKind::kEstimate, 1, {2, 3}));
  EXPECT_EQ(take(), 1);
  offer_key(2);
  EXPECT_EQ(take(), 2);
  EXPECT_EQ(outbox_.joins_total(), 1u);
  EXPECT_EQ(outbox_.dropped_total(), 1u);
}

TEST_F(OutboxTest, PoseDoesNotDisplaceItsKey) {
  join_at(1);
  take();
  offer_ahead(2, {1, 3});
  outbox_.offer(1, frame(FrameKind::kStep, 2, {2, 3}));
  outbox_.offer(1, frame(FrameKind::kStep, 2, {3, 3}));
  EXPECT_EQ(take(), 2);
  EXPECT_EQ(take(), 2);
  EXPECT_EQ(take(), std::nullopt);
  EXPECT_EQ(outbox_.joins_total(), 1u);
  EXPECT_EQ(outbox_.dropped_total(), 1u);
}

TEST_F(OutboxTest, ShownKeyReplacesOlderPose) {
  join_at(1);
  take();
  std::uint64_t s = 2;
  for (const bool ahead : {false, true}) {
    outbox_.offer(1, frame(FrameKind::kEstimate, s - 1, {2, 3}));
    ahead ? offer_ahead(s, {1, 3}) : offer_key(s);
    EXPECT_EQ(take(), static_cast<int>(s++));
    EXPECT_EQ(take(), std::nullopt);
  }
  EXPECT_EQ(outbox_.dropped_total(), 2u);
}

TEST_F(OutboxTest, LastStepAndNextKeyDoNotCompete) {
  join_at(1);
  take();
  offer_ahead(2);
  EXPECT_EQ(take(), 2);
  for (std::uint64_t s = 3; s < 10; ++s) {
    outbox_.offer(1, frame(FrameKind::kStep, s - 1, {3, 3}));
    offer_ahead(s);
    const auto step = outbox_.take(now_, [&](std::uint32_t) { return join_; });
    ASSERT_TRUE(step && step->frame);
    EXPECT_EQ(step->frame->envelope.kind, FrameKind::kStep) << "offered first, leaves first";
    const auto key = outbox_.take(now_, [&](std::uint32_t) { return join_; });
    ASSERT_TRUE(key && key->frame);
    EXPECT_EQ(key->frame->envelope.kind, FrameKind::kKey);
  }
  outbox_.offer(1, frame(FrameKind::kStep, 9, {3, 3}));
  offer_ahead(10);
  outbox_.offer(1, frame(FrameKind::kStep, 10, {1, 3}));
  EXPECT_EQ(take(), 10) << "the key, then the step on it";
  EXPECT_EQ(take(), 10);
  EXPECT_EQ(take(), std::nullopt);
  EXPECT_EQ(outbox_.joins_total(), 1u);
  EXPECT_EQ(outbox_.dropped_total(), 1u);
}

TEST_F(OutboxTest, WhatWasMadeBeforeShownJoinDoesNotFollowIt) {
  join_at(5);
  EXPECT_EQ(take(), -5);
  for (const FramePtr& late : {frame(FrameKind::kJoin, 4), frame(FrameKind::kKey, 5, {}, Envelope::kAhead),
                               frame(FrameKind::kStep, 5, {2, 3}), frame(FrameKind::kStep, 5, {3, 3})}) {
    outbox_.offer(1, late);
    EXPECT_EQ(take(), std::nullopt);
  }
  offer_ahead(7);
  EXPECT_EQ(take(), -7);
  outbox_.offer(1, frame(FrameKind::kStep, 7, {2, 3}));
  EXPECT_EQ(take(), 7) << "this join was not shown";
  offer_ahead(9, {2, 3});
  EXPECT_EQ(take(), -9);
  for (const std::uint8_t at : {1, 2}) {
    const FramePtr late = frame(FrameKind::kStep, 9, {at, 3});
    EXPECT_FALSE(outbox_.send_directly(1, *late, now_));
    outbox_.offer(1, late);
    EXPECT_EQ(take(), std::nullopt) << "the join showed it, or a later one";
  }
  outbox_.offer(1, frame(FrameKind::kStep, 9, {3, 3}));
  EXPECT_EQ(take(), 9);
}

TEST_F(OutboxTest, JoinAfterMissedKeyPrecedesPose) {
  join_at(1);
  take();
  offer_key(2);
  offer_key(3);
  outbox_.offer(1, frame(FrameKind::kEstimate, 3, {1, 3}));
  EXPECT_EQ(take(), -3);
  EXPECT_EQ(take(), 3);
  offer_ahead(4);
  offer_ahead(5);
  outbox_.offer(1, frame(FrameKind::kStep, 5, {1, 3}));
  EXPECT_EQ(take(), -5);
  EXPECT_EQ(take(), 5) << "a step needs its own key";
  EXPECT_EQ(take(), std::nullopt);
}

TEST_F(OutboxTest, JoinSupersedesOlderFrames) {
  join_at(3);
  EXPECT_EQ(take(), -3);
  outbox_.offer(1, frame(FrameKind::kKey, 2));
  EXPECT_EQ(take(), std::nullopt);
  outbox_.offer(1, frame(FrameKind::kStep, 2, {1, 3}));
  EXPECT_EQ(take(), std::nullopt);
  outbox_.offer(1, frame(FrameKind::kKey, 3));
  outbox_.offer(1, frame(FrameKind::kEstimate, 3, {1, 3}));
  EXPECT_EQ(take(), 3);
  EXPECT_EQ(outbox_.joins_total(), 1u);
}

TEST_F(OutboxTest, NewEpochBeginsWithJoin) {
  join_at(9);
  take();
  outbox_.offer(1, frame(FrameKind::kKey, 10));
  outbox_.open_lane(1);
  join_at(1);
  EXPECT_EQ(take(), -1);
  EXPECT_EQ(take(), std::nullopt) << "the frame of the old epoch is gone";
}

TEST_F(OutboxTest, ClientWithoutAcknowledgementsHasNoWindow) {
  join_at(1);
  take();
  for (int s = 2; s < 5000; ++s, now_ += 33'000) {
    offer_key(static_cast<std::uint64_t>(s));
    ASSERT_EQ(take(), s);
  }
}

TEST_F(OutboxTest, WindowIsRoundTripPlusSlack) {
  join_at(1);
  take();
  now_ += 40'000;
  outbox_.acknowledge({1, 1, 0}, now_);
  EXPECT_EQ(outbox_.round_trip_us(), 40'000);
  offer_key(2);
  EXPECT_EQ(take(), 2);
  now_ += 140'000;
  offer_key(3);
  EXPECT_EQ(take(), 3) << "the oldest is 140 ms old: still within";
  now_ += 1;
  offer_key(4);
  EXPECT_EQ(take(), std::nullopt);
  now_ += 500'000;
  for (int s = 5; s < 20; ++s) offer_key(static_cast<std::uint64_t>(s));
  EXPECT_EQ(take(), std::nullopt);
  outbox_.acknowledge({1, 3, 0}, now_);
  EXPECT_EQ(take(), -19) << "awake: the present pose, no backlog";
  EXPECT_EQ(take(), std::nullopt);
}

TEST_F(OutboxTest, WhoAcknowledgesLateGetsNoLongWindow) {
  join_at(1);
  take();
  now_ += 60'000'000;
  outbox_.acknowledge({1, 1, 0}, now_);
  int sent = 0;
  const TimeUs end_us = now_ + 4'900'000;
  for (std::uint64_t s = 2; now_ < end_us; ++s, now_ += 10'000) {
    offer_key(s);
    while (take()) ++sent;
  }
  EXPECT_NEAR(sent, 210, 2) << "2 s and the slack";
}

// It comes back at once, with joins and keys for very many; what is remembered of the way there stays small.
TEST_F(OutboxTest, AWindowOfVeryManyFramesClosesAsLate) {
  join_at(1);
  take();
  outbox_.acknowledge({1, 1, 0}, now_ += 900'000);
  std::uint64_t s = 2;
  for (; now_ < 1'900'000; ++s, now_ += 1'000) {
    offer_key(s);
    EXPECT_EQ(take(), static_cast<int>(s));
  }
  offer_key(s);
  now_ += 1'000;
  EXPECT_EQ(take(), std::nullopt) << "1 s after the oldest";
  outbox_.acknowledge({1, s - 500, 0}, now_);
  EXPECT_TRUE(take()) << "that one and all before it have come";
}

// It is no slow one.
TEST_F(OutboxTest, WhoSeesManyPosesFarAwayMissesNone) {
  constexpr TimeUs kRoundTripUs = 300'000, kAckUs = 33'333;
  join_at(1);
  take();
  outbox_.acknowledge({1, 1, 0}, now_ += kRoundTripUs);
  std::deque<std::pair<TimeUs, std::pair<std::uint64_t, InterpolationStep>>> coming;
  for (int pose = 0; pose < 360 * 5; ++pose, now_ += 1'000'000 / 360) {
    const std::uint64_t s = 2 + static_cast<std::uint64_t>(pose) / 12;
    const InterpolationStep step{static_cast<std::uint8_t>(pose % 12), 12};
    pose % 12 == 0 ? offer_key(s) : outbox_.offer(1, frame(FrameKind::kEstimate, s, step));
    ASSERT_TRUE(take()) << pose;
    const bool is_acked = coming.empty() || now_ + kRoundTripUs >= coming.back().first + kAckUs;
    if (is_acked) coming.push_back({now_ + kRoundTripUs, {s, pose % 12 == 0 ? InterpolationStep{} : step}});
    if (coming.front().first > now_) continue;
    outbox_.acknowledge({1, coming.front().second.first, coming.front().second.second.byte()}, now_);
    coming.pop_front();
  }
  EXPECT_EQ(outbox_.dropped_total(), 0u);
}

TEST_F(OutboxTest, TellsWhetherAJoinIsNeeded) {
  EXPECT_TRUE(outbox_.needs_join());
  join_at(1);
  take();
  EXPECT_FALSE(outbox_.needs_join());
  offer_key(2);
  EXPECT_FALSE(outbox_.needs_join());
  offer_key(3);
  EXPECT_TRUE(outbox_.needs_join()) << "key 2 was skipped";
  take();
  outbox_.miss(1, 1);
  EXPECT_TRUE(outbox_.needs_join());
}

TEST_F(OutboxTest, ClosedWindowStillProbes) {
  join_at(1);
  take();
  outbox_.acknowledge({1, 1, 0}, now_);
  int sent = 0;
  for (int s = 2; s <= 2 + 30 * 16; ++s, now_ += 33'333) {
    offer_key(static_cast<std::uint64_t>(s));
    while (take()) ++sent;
  }
  EXPECT_GE(sent, 4 + 3);
  EXPECT_LE(sent, 5 + 3) << "16 s: what fits in 100 ms, then one every 5 s";
}

TEST_F(OutboxTest, UnknownAcknowledgementsAreIgnored) {
  outbox_.acknowledge({1, 77, 0}, now_);
  outbox_.acknowledge({2, 1, 0}, now_);
  EXPECT_FALSE(outbox_.acknowledges());
}

TEST_F(OutboxTest, StepsOfOneSequenceAreDistinct) {
  join_at(1);
  take();
  outbox_.offer(1, frame(FrameKind::kEstimate, 1, {1, 3}));
  take();
  outbox_.offer(1, frame(FrameKind::kEstimate, 1, {2, 3}));
  take();
  now_ += 10'000;
  outbox_.acknowledge({1, 1, 0x13}, now_);
  now_ += 105'000;
  offer_key(2);
  EXPECT_EQ(take(), std::nullopt) << "(1, 2/3) is still in flight";
  outbox_.acknowledge({1, 1, 0x23}, now_);
  EXPECT_EQ(take(), 2);
}

TEST_F(OutboxTest, ControlGoesFirstAndOverflows) {
  join_at(1);
  ASSERT_TRUE(outbox_.push_control(text("a")));
  ASSERT_TRUE(outbox_.push_control(text("b")));
  EXPECT_EQ(*outbox_.take(0, [&](auto) { return join_; })->text, "a");
  EXPECT_EQ(*outbox_.take(0, [&](auto) { return join_; })->text, "b");
  EXPECT_EQ(take(), -1);
  Outbox small({3, 10, 100'000, 2'000'000, 8});
  EXPECT_TRUE(small.push_control(text("1234")));
  EXPECT_FALSE(small.push_control(text("1234567"))) << "bytes";
  EXPECT_TRUE(small.push_control(text("1")));
  EXPECT_TRUE(small.push_control(text("1")));
  EXPECT_FALSE(small.push_control(text("1"))) << "messages";
}

TEST_F(OutboxTest, DroppableMessagesAreDroppedEarly) {
  Outbox outbox({16, 1000, 100'000, 2'000'000, 8});
  int pushed = 0;
  while (outbox.push_droppable(text("x"))) ++pushed;
  EXPECT_EQ(pushed, 4);
  EXPECT_TRUE(outbox.push_control(text("y")));
}

TEST_F(OutboxTest, LanesTakeTurns) {
  outbox_.open_lane(2);
  join_at(1);
  take();
  take();
  std::vector<std::uint32_t> order;
  for (int round = 0; round < 2; ++round) {
    for (const std::uint32_t id : {1u, 2u}) outbox_.offer(id, frame(FrameKind::kJoin, id));
    while (const auto item = outbox_.take(0, [&](auto) { return join_; })) {
      order.push_back(static_cast<std::uint32_t>(item->frame->envelope.sequence));
      if (item->frame->envelope.sequence == 1 && order.size() < 6) outbox_.offer(1, frame(FrameKind::kJoin, 1));
    }
  }
  EXPECT_EQ(order[0] + order[1], 3u) << "a busy lane does not starve the other";
  outbox_.close_lane(2);
  outbox_.offer(2, frame(FrameKind::kJoin, 2));
  EXPECT_EQ(take(), std::nullopt);
}

TEST_F(OutboxTest, EachLaneHasAWindowOfItsOwn) {
  const auto offer = [&](std::uint32_t id, std::uint64_t sequence) {
    Envelope head;
    head.kind = FrameKind::kJoin;
    head.stream_id = id;
    head.sequence = sequence;
    head.bands = 1;
    outbox_.offer(id, make_frame(head, nullptr, {}));
  };
  const auto sent = [&] {
    std::vector<std::uint32_t> ids;
    while (const auto item = outbox_.take(now_, [](auto) { return nullptr; }))
      ids.push_back(item->frame->envelope.stream_id);
    return ids;
  };
  using Ids = std::vector<std::uint32_t>;
  for (const std::uint32_t id : {4u, 2u, 3u}) outbox_.open_lane(id);
  EXPECT_EQ(sent(), Ids());
  for (const std::uint32_t id : {3u, 1u, 4u, 2u}) offer(id, 1);
  EXPECT_EQ(sent(), (Ids{3, 1, 4, 2})) << "in the order of offers";
  outbox_.acknowledge({1, 1, 0}, now_);
  for (const std::uint32_t id : {1u, 2u, 3u, 4u}) offer(id, 2);
  EXPECT_EQ(sent(), (Ids{1, 2, 3, 4}));
  now_ += 150'000;
  for (const std::uint32_t id : {4u, 3u, 2u, 1u}) offer(id, 3);
  EXPECT_EQ(sent(), Ids()) << "all windows are closed";
  outbox_.acknowledge({3, 2, 0}, now_ - 150'000);
  EXPECT_EQ(sent(), Ids{3});
  offer(3, 4);
  EXPECT_EQ(sent(), Ids{3}) << "its window stays open";
  outbox_.close_lane(4);
  outbox_.open_lane(2);
  offer(2, 5);
  EXPECT_EQ(sent(), Ids{2}) << "it begins anew";
  now_ += 5'000'000;
  EXPECT_EQ(sent(), Ids{1}) << "a probe";
  outbox_.close_lane(1);
  offer(1, 6);
  EXPECT_EQ(sent(), Ids());
}

TEST_F(OutboxTest, HeldReceiverGetsJoinAfterHold) {
  join_at(1);
  EXPECT_EQ(take(), -1);
  outbox_.hold_from(500);
  offer_key(2);
  EXPECT_EQ(take(), 2) << "not yet";
  now_ = 500;
  for (std::uint64_t s = 3; s < 30; ++s) offer_key(s);
  EXPECT_EQ(take(), std::nullopt);
  EXPECT_FALSE(outbox_.send_directly(1, *frame(FrameKind::kKey, 3), now_));
  now_ = 60'000'000;
  EXPECT_EQ(take(), std::nullopt) << "however long it takes";
  ASSERT_TRUE(outbox_.push_control(text("control")));
  EXPECT_TRUE(outbox_.take(now_, [](std::uint32_t) { return nullptr; })->text);
  outbox_.hold_from(ReaderWatch::kNever);
  EXPECT_EQ(take(), -29);
  EXPECT_EQ(take(), std::nullopt);
  outbox_.hold_from(0);
  outbox_.acknowledge({1, 29, 0}, now_);
  offer_key(30);
  EXPECT_EQ(take(), 30) << "acknowledging opens a window";
}

TEST_F(OutboxTest, FramesWaitUntilTheyArePaidFor) {
  join_at(1);
  EXPECT_EQ(take(), -1);
  outbox_.acknowledge({1, 1, 0}, now_);
  outbox_.hold_until(500);
  offer_key(2);
  offer_key(3);
  EXPECT_EQ(take(), std::nullopt) << "acknowledged or not";
  EXPECT_FALSE(outbox_.send_directly(1, *frame(FrameKind::kKey, 2), now_));
  ASSERT_TRUE(outbox_.push_control(text("control")));
  EXPECT_TRUE(outbox_.take(now_, [](std::uint32_t) { return nullptr; })->text);
  now_ = 500;
  EXPECT_EQ(take(), -3) << "the newest, by a join";
}

TEST_F(OutboxTest, WhoMissesFramesGetsAJoinOnce) {
  join_at(1);
  EXPECT_EQ(take(), -1);
  offer_key(2);
  outbox_.hold_until(500);
  EXPECT_TRUE(outbox_.is_held(499));
  outbox_.miss(1, 3);
  outbox_.miss(2, 5);  // It is not watched.
  EXPECT_EQ(outbox_.dropped_total(), 4u) << "and the one that waited";
  EXPECT_EQ(take(), std::nullopt);
  now_ = 500;
  EXPECT_FALSE(outbox_.is_held(now_));
  join_at(5);
  EXPECT_EQ(take(), -5);
  EXPECT_EQ(take(), std::nullopt);
  offer_key(6);
  EXPECT_EQ(take(), 6);
}

TEST_F(OutboxTest, OnlyTheLatestPongIsSent) {
  while (outbox_.push_droppable(text("control"))) {
  }
  for (const char* pong : {"1", "2", "3"}) EXPECT_FALSE(outbox_.push_pong(text(pong)));
  join_at(1);
  const auto next = [&] { return outbox_.take(now_, [&](std::uint32_t) { return join_; }); };
  auto item = next();
  while (*item->text == "control") item = next();
  EXPECT_EQ(*item->text, "3");
  EXPECT_TRUE(next()->frame);
  EXPECT_FALSE(next());
}

TEST_F(OutboxTest, PongOfOlderPingNeverFollowsNewerOne) {
  while (outbox_.push_droppable(text("control"))) {
  }
  EXPECT_FALSE(outbox_.push_pong(text("1")));
  const auto next = [&] { return outbox_.take(now_, [](std::uint32_t) { return nullptr; }); };
  for (int i = 0; i < 2; ++i) EXPECT_EQ(*next()->text, "control");
  EXPECT_TRUE(outbox_.push_pong(text("2"))) << "there is room now";
  std::vector<std::string> pongs;
  while (const auto item = next()) {
    if (*item->text != "control") pongs.push_back(*item->text);
  }
  EXPECT_EQ(pongs, (std::vector<std::string>{"1", "2"}));
}

// Its stream has begun anew, or another profile of it, since the pose was taken.
TEST_F(OutboxTest, WhatAFormerLaneDidNotSendGoesWithIt) {
  join_at(7);
  take();
  Envelope head = frame(FrameKind::kEstimate, 7, {1, 3})->envelope;
  head.stream_id = 1;
  const FramePtr former = make_frame(head, nullptr, {});
  outbox_.offer(1, former);
  EXPECT_EQ(take(), 7);
  outbox_.open_lane(1);
  outbox_.drop_unsent(former);
  EXPECT_EQ(take(), -7);
  EXPECT_EQ(take(), std::nullopt);
}

TEST_F(OutboxTest, AnAcknowledgementOpensItsLaneOnly) {
  outbox_.open_lane(2);
  join_at(1);
  while (take()) {
  }
  outbox_.acknowledge({1, 1, 0}, now_);
  for (const std::uint32_t id : {1u, 2u}) outbox_.offer(id, frame(FrameKind::kKey, 2));
  while (take()) {
  }
  now_ += 150'000;
  for (const std::uint32_t id : {1u, 2u}) outbox_.offer(id, frame(FrameKind::kKey, 3));
  EXPECT_EQ(take(), std::nullopt);
  EXPECT_EQ(outbox_.waiting(now_), 0u);
  outbox_.acknowledge({2, 2, 0}, now_ - 150'000);
  EXPECT_EQ(outbox_.waiting(now_), 1u);
  EXPECT_EQ(take(), 3);
}

/// A receiver behind an outbox, that knows what it must get, against which any order of calls is held.
class OutboxModel {
 public:
  OutboxModel(unsigned seed, bool acknowledges) : random_(seed), acknowledges_(acknowledges) {
    open(1);
    offer(1, true);
    drain();
    write();
    if (acknowledges_) outbox_.acknowledge({1, 1, 0}, now_);
    lanes_[1].in_flight.clear();
  }

  void step() {
    now_ += below(4) == 0 ? below(200'000) : below(2'000);
    const std::uint32_t id = 1 + below(6);
    const bool is_open = lanes_.contains(id);
    switch (below(16)) {
      case 0: return is_open && below(3) > 0 ? close(id) : open(id);
      case 1: return outbox_.hold_until(now_ + below(100'000));
      case 2: return is_open ? miss(id) : void();
      case 3:
      case 4: return drop();
      case 5:
      case 6:
      case 7: return write();
      case 8:
      case 9: return acknowledge(id);
      case 10:
      case 11: return drain();
      default: return is_open ? offer(id, below(3) > 0) : void();
    }
  }

  /// All links work again: everybody has the newest key of all that it watches.
  void end() {
    outbox_.hold_until(0);
    for (int i = 0; i < 3; ++i, now_ += 6'000'000) {
      drain();
      write();
    }
    for (const auto& [id, lane] : lanes_) EXPECT_EQ(lane.has.value_or(0), lane.newest) << id;
    EXPECT_EQ(outbox_.waiting(now_), 0u);
  }

 private:
  struct Lane {
    std::uint64_t newest = 0;            // Key offered ...
    std::uint8_t shown = 0;              // ... and the estimate.
    std::optional<std::uint64_t> sent;   // Key that left the outbox ...
    std::optional<std::uint64_t> has;    // ... and that was written.
    std::uint64_t opened = 0;
    TimeUs last_us = 0;
    std::vector<std::pair<Envelope, TimeUs>> in_flight;
  };
  struct Taken {
    FramePtr frame;
    std::uint64_t opened = 0;
  };

  unsigned below(unsigned end) { return static_cast<unsigned>(random_() % end); }
  FramePtr made(FrameKind kind, std::uint32_t id, std::uint64_t sequence, InterpolationStep step = {}) const {
    Envelope head = frame(kind, sequence, step)->envelope;
    head.stream_id = id;
    const ChainClock newest;
    return make_frame(head, &newest, {});
  }
  void open(std::uint32_t id) {
    outbox_.open_lane(id);
    const std::uint64_t newest = lanes_[id].newest;
    lanes_[id] = {newest, 0, {}, {}, ++opened_, 0, {}};
  }
  void close(std::uint32_t id) {
    outbox_.close_lane(id);
    lanes_.erase(id);
  }
  void miss(std::uint32_t id) {
    outbox_.miss(id, 1);
    lanes_[id].sent.reset();
  }
  void offer(std::uint32_t id, bool key) {
    Lane& lane = lanes_[id];
    if (!key && (lane.newest == 0 || lane.shown == 15)) return;
    if (key) ++lane.newest;
    const std::uint8_t at = lane.shown = key ? std::uint8_t{0} : static_cast<std::uint8_t>(lane.shown + 1);
    outbox_.offer(id, key ? made(FrameKind::kKey, id, lane.newest)
                          : made(FrameKind::kEstimate, id, lane.newest, {at, 15}));
  }
  bool is_closed(const Lane& lane) const {
    if (!acknowledges_ || lane.in_flight.empty()) return false;
    const Outbox::Limits limits;
    const TimeUs trip = std::min(outbox_.round_trip_us().value_or(0), limits.max_round_trip_us);
    return now_ - lane.in_flight.front().second > trip + limits.window_slack_us &&
           now_ - lane.last_us < limits.probe_us;
  }
  void drain() {
    const auto join_of = [this](std::uint32_t id) {
      const std::uint64_t newest = lanes_[id].newest;
      return newest == 0 ? nullptr : made(FrameKind::kJoin, id, newest);
    };
    while (const auto item = outbox_.take(now_, join_of)) {
      const Envelope& head = item->frame->envelope;
      ASSERT_TRUE(lanes_.contains(head.stream_id)) << "of a lane that is closed";
      Lane& lane = lanes_[head.stream_id];
      EXPECT_FALSE(outbox_.is_held(now_) || is_closed(lane));
      if (head.is_key()) lane.sent = head.sequence;
      lane.last_us = now_;
      if (acknowledges_) lane.in_flight.emplace_back(head, now_);
      taken_.push_back({item->frame, lane.opened});
    }
    if (outbox_.is_held(now_)) return;
    for (const auto& [id, lane] : lanes_)
      EXPECT_TRUE(is_closed(lane) || lane.sent.value_or(0) == lane.newest) << "lane " << id << " was forgotten";
  }
  void write() {
    for (const auto& [frame, opened] : std::exchange(taken_, {})) {
      const Envelope& head = frame->envelope;
      const auto lane = lanes_.find(head.stream_id);
      if (lane == lanes_.end() || lane->second.opened != opened) continue;
      std::optional<std::uint64_t>& has = lane->second.has;
      EXPECT_TRUE(head.kind == FrameKind::kJoin || has == frame->builds_on) << "it cannot be decoded";
      if (!head.is_key()) continue;
      EXPECT_GE(head.sequence, has.value_or(0)) << "nothing stale after newer";
      has = head.sequence;
    }
  }
  /// The link blocks: the end of what was taken is not written.
  void drop() {
    const std::size_t kept = taken_.empty() ? 0 : below(static_cast<unsigned>(taken_.size() + 1));
    const std::vector<Taken> dropped(taken_.begin() + static_cast<std::ptrdiff_t>(kept), taken_.end());
    taken_.resize(kept);
    for (const auto& [frame, opened] : dropped) {
      outbox_.drop_unsent(frame);
      const Envelope& head = frame->envelope;
      const auto found = lanes_.find(head.stream_id);
      if (found == lanes_.end()) continue;
      Lane& lane = found->second;
      if (head.is_key()) lane.sent.reset();
      std::erase_if(lane.in_flight, [&](const auto& sent) {
        return sent.first.sequence == head.sequence && sent.first.step == head.step;
      });
    }
    write();
  }
  void acknowledge(std::uint32_t id) {
    if (!acknowledges_ || !lanes_.contains(id)) return;
    auto& in_flight = lanes_[id].in_flight;
    if (in_flight.empty()) return outbox_.acknowledge({id, below(100), 0}, now_);
    const Envelope of = in_flight[below(static_cast<unsigned>(in_flight.size()))].first;
    const auto match = std::find_if(in_flight.rbegin(), in_flight.rend(), [&](const auto& sent) {
      return sent.first.sequence == of.sequence && sent.first.step == of.step;
    });
    outbox_.acknowledge({id, of.sequence, of.step.byte()}, now_);
    in_flight.erase(in_flight.begin(), match.base());
  }

  std::mt19937 random_;
  bool acknowledges_;
  Outbox outbox_;
  std::map<std::uint32_t, Lane> lanes_;
  std::vector<Taken> taken_;
  std::uint64_t opened_ = 0;
  TimeUs now_ = 1'000'000;
};

TEST(OutboxOrders, WhateverHappensEachFrameCanBeDecodedAndTheNewestComes) {
  for (unsigned seed = 0; seed < 200 && !::testing::Test::HasFailure(); ++seed) {
    SCOPED_TRACE(seed);
    OutboxModel model(seed, seed % 2 == 0);
    for (int i = 0; i < 500; ++i) model.step();
    model.end();
  }
}

}  // namespace
}  // namespace eigencast::broker
