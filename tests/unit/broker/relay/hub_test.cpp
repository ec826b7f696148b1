// SPDX-License-Identifier: MIT
#include "broker/relay/hub.h"

#include <gtest/gtest.h>

#include "tests/unit/broker/support.h"

namespace eigencast::broker {
namespace {

using testing::FakeReceiver;
using testing::FakeSender;
using testing::kFull;
using testing::kInterval;
using testing::kRaw;
using testing::small_announce;

TEST(HubTest, PumpsStreamsWhenDue) {
  Hub hub({8, {}});
  std::vector<Stream*> streams;
  std::vector<FakeSender> senders(3);
  std::vector<FakeReceiver> receivers(3);
  for (std::size_t i = 0; i < 3; ++i) {
    streams.push_back(*hub.open("s" + std::to_string(i)));
    ASSERT_TRUE(streams[i]->claim(senders[i]));
    ASSERT_TRUE(streams[i]->announce(small_announce(), 1));
    ASSERT_TRUE(streams[i]->watch(receivers[i], i == 2 ? kRaw : kFull));
  }
  // Keys of stream 1 come a third of an interval behind those of stream 0.
  TimeUs now = 1'000'000;
  for (const TimeUs end = now + 10 * kInterval; now < end; now += 1000) {
    for (std::size_t i = 0; i < 3; ++i) {
      if ((now - static_cast<TimeUs>(i) * 10'000) % kInterval != 0) continue;
      ASSERT_TRUE(streams[i]->take_frame(senders[i].next(now), now));
      hub.mark_dirty(*streams[i]);
    }
    hub.deliver();
    std::optional<TimeUs> earliest;
    for (const Stream* stream : streams) {
      const auto due = stream->next_due_us();
      if (due && (!earliest || *due < *earliest)) earliest = due;
    }
    EXPECT_EQ(hub.next_due_us(), earliest);
    if (earliest && *earliest <= now) hub.pump(now);
    EXPECT_TRUE(!hub.next_due_us() || *hub.next_due_us() > now);
  }
  EXPECT_GE(receivers[0].frames.size(), 25u);
  EXPECT_GE(receivers[1].frames.size(), 22u);
  EXPECT_LE(receivers[2].frames.size(), 10u);
  streams[0]->release(senders[0]);
  streams[0]->unwatch(receivers[0]);
  hub.mark_dirty(*streams[0]);
  hub.deliver();
  EXPECT_FALSE(streams[0]->next_due_us()) << "no watchers";
  EXPECT_EQ(hub.next_due_us(), streams[1]->next_due_us());
}

TEST(HubTest, IdsAreStableAndUnusedStreamsMakeRoom) {
  Hub hub({2, {}});
  Stream* a = hub.open("a").value();
  EXPECT_EQ(hub.open("a").value(), a);
  FakeSender sender;
  ASSERT_TRUE(a->claim(sender));
  ASSERT_TRUE(a->announce(small_announce(), 1));
  Stream* b = hub.open("b").value();
  FakeReceiver receiver;
  ASSERT_TRUE(b->watch(receiver, kRaw));
  EXPECT_NE(a->id(), b->id());
  EXPECT_EQ(hub.open("c").error().code, ErrorCode::kTooLarge);
  a->release(sender);
  hub.unwatched(*a);
  EXPECT_EQ(hub.find("a"), a) << "its last pose is held";
  EXPECT_TRUE(hub.open("c"));
  EXPECT_EQ(hub.find("a"), nullptr) << "it made room";
  b->unwatch(receiver);
  hub.unwatched(*b);
  EXPECT_EQ(hub.find("b"), nullptr) << "it never had a pose";
}

}  // namespace
}  // namespace eigencast::broker
