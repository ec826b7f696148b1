// SPDX-License-Identifier: MIT
#include "broker/relay/hub.h"
#include "common/core/share.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>

#include "tests/unit/broker/support.h"

namespace eigencast::broker {
namespace {

using testing::FakeAccount;
using testing::FakeReceiver;
using testing::FakeSender;
using testing::kInterval;
using testing::kLinear;
using testing::kRaw;
using testing::large_announce;
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
    ASSERT_TRUE(streams[i]->watch(receivers[i], i == 2 ? kRaw : kLinear));
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
    hub.pump(now);
    hub.deliver();
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

class RoomTest : public ::testing::Test {
 protected:
  explicit RoomTest(std::size_t max_streams = 4, std::int64_t max_bytes = Shares::kUnlimited)
      : hub_({.max_streams = max_streams,
              .stream = {.max_bytes = max_bytes, .memory = memory_},
              .ids = std::make_shared<StreamIds>(100)}) {}

  /// Whether the sender may announce.
  Result<void> announce(FakeSender& sender, const std::string& name, const StreamHolder& holder, FakeAccount& account,
                        const control::Announce& announcement = small_announce()) {
    Stream* stream = hub_.open(name).value();
    EXPECT_TRUE(stream->has_publisher() || stream->claim(sender));
    auto admitted = hub_.admit(*stream, holder, announcement.format, account.charge());
    if (admitted) {
      EXPECT_TRUE(stream->announce(announcement, ++epoch_));
    }
    return admitted;
  }
  void leave(FakeSender& sender, const std::string& name) {
    Stream* stream = hub_.find(name);
    stream->release(sender);
    hub_.unwatched(*stream);
  }
  /// A sender that comes and goes.
  Result<void> flap(const std::string& name, const StreamHolder& holder, FakeAccount& account) {
    FakeSender sender;
    auto admitted = announce(sender, name, holder, account);
    leave(sender, name);
    return admitted;
  }
  bool holds(const std::string& name) { return hub_.find(name) != nullptr; }

  const std::shared_ptr<StreamMemory> memory_ = std::make_shared<StreamMemory>();
  Hub hub_;
  FakeAccount account_;
  std::uint32_t epoch_ = 0;
  const StreamHolder camera_{"camera"}, other_{"other"}, stranger_{"address", true};
};

TEST_F(RoomTest, StreamsStayForWatchersOrHeldPoses) {
  Stream* a = hub_.open("a").value();
  EXPECT_EQ(hub_.open("a").value(), a);
  Stream* b = hub_.open("b").value();
  EXPECT_NE(a->id(), b->id());
  ASSERT_TRUE(flap("a", camera_, account_));
  EXPECT_EQ(hub_.find("a"), a) << "its last pose is held";
  FakeReceiver receiver;
  ASSERT_TRUE(b->watch(receiver, kRaw));
  b->unwatch(receiver);
  hub_.unwatched(*b);
  EXPECT_FALSE(holds("b")) << "it never had a pose";
}

TEST_F(RoomTest, InventedNamesLeaveSendersTheirRoom) {
  FakeAccount viewers;
  std::vector<Stream*> names;
  std::vector<FakeReceiver> receivers(94);
  for (std::size_t i = 0; i < 94; ++i) {
    names.push_back(hub_.open("invented/" + std::to_string(i), viewers.charge()).value());
    ASSERT_TRUE(names.back()->watch(receivers[i], kRaw));
  }
  EXPECT_EQ(hub_.open("one more", viewers.charge()).error().code, ErrorCode::kTooLarge);
  EXPECT_FALSE(holds("one more"));
  std::array<FakeSender, 5> senders;
  for (std::size_t i = 0; i < 4; ++i) ASSERT_TRUE(announce(senders[i], std::to_string(i), camera_, account_));
  EXPECT_EQ(announce(senders[4], "invented/0", camera_, account_).error().code, ErrorCode::kTooLarge);
  leave(senders[4], "invented/0");
  leave(senders[3], "3");
  EXPECT_EQ(viewers.held(), 94u);
  ASSERT_TRUE(announce(senders[4], "invented/0", camera_, account_));
  EXPECT_EQ(viewers.held(), 93u) << "a sender has announced it";
  EXPECT_TRUE(hub_.open("one more", viewers.charge()));
  EXPECT_EQ(account_.held(), 4u);
}

TEST_F(RoomTest, HolderInventsNoMoreNamesThanItsShare) {
  FakeAccount viewers;
  for (int holder = 0; holder < 16; ++holder) {
    const auto invent = [&](int i) {
      return hub_.open(std::to_string(holder) + "/" + std::to_string(i), viewers.charge(), std::to_string(holder));
    };
    EXPECT_TRUE(invent(0)) << holder;
    int names = 1;
    while (invent(names)) ++names;
    EXPECT_LE(names, 26 - holder);
  }
  EXPECT_EQ(hub_.open("0/more", viewers.charge(), "0").error().code, ErrorCode::kTooLarge);
  EXPECT_TRUE(hub_.open("soon", viewers.charge(), "newcomer"));
}

TEST_F(RoomTest, UnannouncedNameIsChargedWhoeverOpenedIt) {
  FakeAccount viewers;
  FakeSender sender;
  Stream* stream = hub_.open("a").value();
  ASSERT_TRUE(stream->claim(sender));
  ASSERT_TRUE(hub_.admit(*stream, camera_, small_announce().format, account_.charge()));
  FakeReceiver receiver;
  ASSERT_TRUE(hub_.open("a", viewers.charge()).value()->watch(receiver, kRaw));
  EXPECT_EQ(viewers.held(), 1u);
  leave(sender, "a");
  EXPECT_EQ(account_.held(), 0u) << "its sender never announced it";
  stream->unwatch(receiver);
  hub_.unwatched(*stream);
  EXPECT_EQ(viewers.held(), 0u);
}

TEST_F(RoomTest, FlappingSendersDisplaceTheirOwnPoses) {
  ASSERT_TRUE(flap("kept/1", camera_, account_));
  ASSERT_TRUE(flap("kept/2", camera_, account_));
  ASSERT_TRUE(flap("kept/3", camera_, account_));
  for (int i = 0; i < 20; ++i) ASSERT_TRUE(flap("flap/" + std::to_string(i), other_, account_));
  EXPECT_TRUE(holds("kept/1") && holds("kept/2") && holds("kept/3") && holds("flap/19"));
  for (int i = 0; i < 20; ++i) (void)flap("stranger/" + std::to_string(i), stranger_, account_);
  EXPECT_TRUE(holds("kept/1") && holds("kept/2") && holds("flap/19")) << "strangers displace no token's pose";
  EXPECT_EQ(hub_.size(), 4u);
}

TEST_F(RoomTest, SenderDisplacesStrangersFirst) {
  ASSERT_TRUE(flap("stranger", stranger_, account_));
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(flap("own/" + std::to_string(i), camera_, account_));
  ASSERT_TRUE(flap("new", camera_, account_));
  EXPECT_FALSE(holds("stranger"));
  ASSERT_TRUE(flap("newer", other_, account_));
  EXPECT_FALSE(holds("own/0")) << "the oldest of the holder of most";
}

TEST_F(RoomTest, HolderAtLimitGivesUpOldestPose) {
  FakeAccount two(2);
  FakeReceiver receiver;
  ASSERT_TRUE(flap("watched", other_, two));
  ASSERT_TRUE(hub_.find("watched")->watch(receiver, kRaw));
  ASSERT_TRUE(flap("a", other_, two));
  ASSERT_TRUE(flap("b", other_, two));
  EXPECT_TRUE(!holds("a") && holds("b"));
  ASSERT_TRUE(hub_.find("b")->watch(receiver, kRaw));
  EXPECT_EQ(flap("c", other_, two).error().code, ErrorCode::kRefused);
  ASSERT_TRUE(flap("watched", camera_, account_)) << "its present sender pays";
  EXPECT_EQ(two.held(), 1u);
}

class RoomForManyTest : public RoomTest {
 protected:
  RoomForManyTest() : RoomTest(1'024) {}
};

TEST_F(RoomForManyTest, ManyStreamsOfOneAreDeliveredInSlicesAndDelayOthersByOneSlice) {
  constexpr std::size_t kStreams = 20, kOfSlice = 4;
  std::vector<FakeSender> senders(kStreams + 1);
  std::vector<FakeReceiver> receivers(kStreams + 1);
  std::vector<Stream*> streams;
  for (std::size_t i = 0; i <= kStreams; ++i) {
    const std::string name = "s" + std::to_string(i);
    ASSERT_TRUE(announce(senders[i], name, i < kStreams ? stranger_ : camera_, account_));
    streams.push_back(hub_.find(name));
    ASSERT_TRUE(streams[i]->watch(receivers[i], kRaw));
  }
  auto key = [&, now = TimeUs{1'000'000}](std::size_t i) mutable {
    now += 1'000;
    ASSERT_TRUE(streams[i]->take_frame(senders[i].next(now), now));
    hub_.mark_dirty(*streams[i]);
  };
  const auto came = [&] {
    return std::count_if(receivers.begin(), receivers.end(), [](const auto& one) { return !one.frames.empty(); });
  };
  for (std::size_t i = 0; i < kStreams; ++i) key(i);
  const double slice_us = kOfSlice;  // A delivery counts a little more than a microsecond.
  EXPECT_TRUE(hub_.deliver(slice_us));
  EXPECT_EQ(came(), std::ptrdiff_t{kOfSlice});
  key(kStreams);
  key(kStreams - 1);
  leave(senders[kStreams - 2], "s18");
  streams[kStreams - 2]->unwatch(receivers[kStreams - 2]);
  hub_.drop(*streams[kStreams - 2]);
  EXPECT_TRUE(hub_.deliver(slice_us));
  EXPECT_EQ(receivers[kStreams].frames.size(), 1u) << "at most one of each other sender before it";
  EXPECT_EQ(came(), std::ptrdiff_t{2 * kOfSlice + 1}) << "and the last of the sender that left";
  int turns = 2;
  for (; hub_.deliver(slice_us); ++turns) {
  }
  EXPECT_LE(turns, 6);
  EXPECT_EQ(came(), std::ptrdiff_t{kStreams + 1}) << "all";
  EXPECT_EQ(receivers[kStreams - 1].frames.size(), 2u) << "of what waited twice";
}

TEST_F(RoomForManyTest, FramesThatAreDueAreMadeInSlices) {
  constexpr std::size_t kStreams = 20, kOfSlice = 4;
  std::vector<FakeSender> senders(kStreams);
  std::vector<FakeReceiver> receivers(kStreams);
  for (std::size_t i = 0; i < kStreams; ++i) {
    const std::string name = "s" + std::to_string(i);
    ASSERT_TRUE(announce(senders[i], name, stranger_, account_));
    ASSERT_TRUE(hub_.find(name)->watch(receivers[i], kLinear));
    for (const TimeUs now_us : {1'000'000, 1'030'000})
      ASSERT_TRUE(hub_.find(name)->add_frame(senders[i].next(now_us), now_us));
    hub_.mark_dirty(*hub_.find(name));
  }
  hub_.deliver();
  for (auto& receiver : receivers) receiver.frames.clear();
  hub_.pump(2'000'000);
  const auto came = [&] {
    return std::count_if(receivers.begin(), receivers.end(), [](const auto& one) { return !one.frames.empty(); });
  };
  EXPECT_EQ(came(), 0);
  EXPECT_TRUE(hub_.deliver(kOfSlice));
  EXPECT_EQ(came(), std::ptrdiff_t{kOfSlice});
  while (hub_.deliver(kOfSlice)) {
  }
  EXPECT_EQ(came(), std::ptrdiff_t{kStreams}) << "all";
}

TEST_F(RoomForManyTest, StrangersLeaveRoomToSendersWithTokensAndToEachOther) {
  std::array<FakeSender, 1'100> senders;
  FakeAccount many(2'000);
  std::size_t next = 0;
  const auto fill = [&](const StreamHolder& holder) {
    std::size_t count = 0;
    for (; announce(senders[next], std::to_string(next), holder, many); ++next) ++count;
    leave(senders[next], std::to_string(next));
    return count;
  };
  EXPECT_EQ(fill(stranger_), 153u) << "a fifth of three quarters";
  for (int i = 0; i < 10; ++i) EXPECT_GE(fill({"address " + std::to_string(i), true}), 10u) << i;
  EXPECT_LE(next, 768u);
  EXPECT_GE(fill(camera_), 256u) << "as many as are free";
  for (std::size_t i = 0; i < next; ++i) leave(senders[i], std::to_string(i));
}

const std::int64_t kLargeBytes = keys_bytes(large_announce().format);

class KeysTest : public RoomTest {
 protected:
  KeysTest() : RoomTest(100, 22 * kLargeBytes) {}
  Result<void> announce_large(FakeSender& sender, const std::string& name, const StreamHolder& holder) {
    return announce(sender, name, holder, account_, large_announce());
  }
};

TEST(ShareTest, WhoIsSparedHasNoLessThanOthers) {
  for (std::int64_t used = 0; used <= 64; ++used) {
    for (std::int64_t own = 0; own <= used; ++own) {
      EXPECT_GE(share_of(64, used, own, true), share_of(64, used, own)) << used << " " << own;
      EXPECT_LE(share_of(64, used, own, true), own + 64 - used);
    }
  }
  EXPECT_EQ(share_of(64, 0, 0, true), 60);
}

TEST_F(KeysTest, HolderHasAShareOfTheirMemory) {
  std::array<FakeSender, 7> senders;
  for (std::size_t i = 0; i < 4; ++i) ASSERT_TRUE(announce_large(senders[i], std::to_string(i), camera_));
  EXPECT_EQ(announce_large(senders[4], "4", camera_).error().code, ErrorCode::kTooLarge);
  EXPECT_EQ(account_.held(), 4u) << "nothing is counted of what was refused";
  ASSERT_TRUE(announce(senders[4], "4", camera_, account_)) << "a small one";
  EXPECT_EQ(announce_large(senders[4], "4", camera_).error().code, ErrorCode::kTooLarge) << "it becomes large";
  EXPECT_EQ(memory_->keys.used(), 4 * kLargeBytes + keys_bytes(small_announce().format));
  ASSERT_TRUE(announce_large(senders[0], "0", camera_)) << "once more the same";
  ASSERT_TRUE(announce_large(senders[5], "5", other_)) << "others have theirs";
  leave(senders[0], "0");
  ASSERT_TRUE(announce_large(senders[4], "4", camera_)) << "its oldest pose makes room";
  EXPECT_FALSE(holds("0"));
  const StreamHolder own_machine{"loopback", false, true};
  std::array<FakeSender, 20> many;
  std::size_t announced = 0;
  while (announce_large(many[announced], "own/" + std::to_string(announced), own_machine)) ++announced;
  EXPECT_EQ(announced, 15u) << "all but a sixteenth";
}

TEST_F(KeysTest, HeldPosesLeaveNewcomersTheirShare) {
  for (int i = 0; i < 50; ++i) {
    FakeSender sender;
    const StreamHolder holder{"holder " + std::to_string(i)};
    ASSERT_TRUE(announce_large(sender, std::to_string(i), holder)) << i;
    leave(sender, std::to_string(i));
    EXPECT_LE(memory_->keys.used(), 22 * kLargeBytes);
  }
  EXPECT_GT(hub_.size(), 10u) << "no more of them go than need to";
}

TEST_F(KeysTest, PosesOfThoseWhoHaveLessStay) {
  for (int i = 0; i < 20; ++i)
    ASSERT_TRUE(flap("small/" + std::to_string(i), {"holder " + std::to_string(i)}, account_));
  std::array<FakeSender, 10> senders;
  std::size_t announced = 0;
  while (announce_large(senders[announced], std::to_string(announced), camera_)) ++announced;
  EXPECT_EQ(announced, 4u);
  EXPECT_EQ(hub_.size(), 20u + announced + 1) << "none of them made room";
  ASSERT_TRUE(announce_large(senders[9], "other", other_));
  EXPECT_EQ(hub_.size(), 20u + announced + 2);
}

TEST_F(KeysTest, StreamsOfOtherBrokersCount) {
  const auto hold = [this](int name, const char* broker) {
    return hub_.hold_keys(**hub_.open(std::to_string(name)), {broker}, large_announce().format);
  };
  for (int i = 0; i < 4; ++i) ASSERT_TRUE(hold(i, "broker a"));
  EXPECT_EQ(hold(4, "broker a").error().code, ErrorCode::kTooLarge);
  EXPECT_TRUE(hold(4, "broker b"));
  for (int i = 0; i < 5; ++i) hub_.unwatched(*hub_.find(std::to_string(i)));
  EXPECT_EQ(memory_->keys.used(), 0);
}

TEST(StreamIdsTest, LowestFreeIdComesFirst) {
  StreamIds ids(10, 3);
  auto a = ids.of("a").value(), b = ids.of("b").value(), c = ids.of("c").value();
  EXPECT_EQ((std::vector{a->id, b->id, c->id}), (std::vector<std::uint32_t>{1, 2, 3}));
  EXPECT_EQ(ids.of("d").error().code, ErrorCode::kTooLarge);
  EXPECT_EQ(ids.of("c").value(), c);
  b.reset();
  a.reset();
  EXPECT_EQ(ids.of("d").value()->id, 1U);
  EXPECT_EQ(ids.of("b", [] { return Result<std::shared_ptr<void>>(fail(ErrorCode::kRefused, "no")); }).error().code,
            ErrorCode::kRefused);
  EXPECT_EQ(ids.of("b").value()->id, 1U) << "what was refused has no id";
}

TEST(StreamIdsTest, TagsGoOnWhereAnIdIsUsedAgain) {
  StreamIds ids;
  std::vector<std::uint8_t> tags;
  for (int i = 0; i < 300; ++i) {
    const auto share = ids.of("stream " + std::to_string(i)).value();
    ASSERT_EQ(share->id, 1U);
    tags.push_back(++share->tag);
    if (i % 3 == 0) tags.push_back(++share->tag);
  }
  for (std::size_t i = 0; i < tags.size(); ++i) {
    const std::size_t first = i < 16 ? 0 : i - 16;
    EXPECT_EQ(std::count(&tags[first], &tags[i], tags[i]), 0) << i;
  }
}

}  // namespace
}  // namespace eigencast::broker
