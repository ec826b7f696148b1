// SPDX-License-Identifier: MIT
#include "broker/backbone/follower.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "common/wire/envelope.h"

namespace eigencast::broker {
namespace {

constexpr std::uint32_t kEpoch = 5;

Bytes message(FrameKind kind, std::uint64_t sequence, std::uint32_t epoch = kEpoch) {
  Envelope head;
  head.kind = kind;
  head.bands = 1;
  head.sequence = sequence;
  const ChainClock before{sequence - 1, 0, 0};
  Bytes bytes;
  ByteWriter writer(bytes);
  writer.u32(epoch);
  writer.u64(sequence);
  append_envelope(head, &before, bytes);
  bytes.push_back(0);
  return bytes;
}
Bytes key(std::uint64_t sequence) {
  return message(FrameKind::kKey, sequence);
}
Bytes join(std::uint64_t sequence) {
  return message(FrameKind::kJoin, sequence);
}
/// The low bytes of the sequences of keys.
std::vector<std::uint64_t> sequences(const std::vector<Follower::Followed>& frames) {
  std::vector<std::uint64_t> numbers;
  for (const auto& [sequence, bytes, frame] : frames) {
    numbers.push_back(frame.envelope.kind == FrameKind::kJoin ? frame.envelope.sequence : frame.check);
  }
  return numbers;
}
using Numbers = std::vector<std::uint64_t>;

TEST(Follower, JoinIsFollowedByKeptKeys) {
  Follower follower(kEpoch);
  EXPECT_TRUE(follower.wants_join(0));
  EXPECT_FALSE(follower.wants_join(1)) << "asked already";
  EXPECT_EQ(sequences(follower.take(key(7))), Numbers{});
  EXPECT_EQ(sequences(follower.take(key(8))), Numbers{});
  EXPECT_EQ(sequences(follower.take(key(9))), Numbers{});
  EXPECT_EQ(sequences(follower.take(join(7))), (Numbers{7, 8, 9}));
  EXPECT_EQ(sequences(follower.take(key(10))), Numbers{10});
  EXPECT_FALSE(follower.wants_join(1'000'000'000));
}

TEST(Follower, RequestsJoinAgainAfterTimeout) {
  Follower follower(kEpoch);
  EXPECT_TRUE(follower.wants_join(0));
  EXPECT_FALSE(follower.wants_join(Follower::kJoinTimeoutUs - 1));
  EXPECT_TRUE(follower.wants_join(Follower::kJoinTimeoutUs));
}

TEST(Follower, GapNeedsJoin) {
  Follower follower(kEpoch);
  (void)follower.take(join(1));
  EXPECT_EQ(sequences(follower.take(key(3))), Numbers{});
  EXPECT_TRUE(follower.wants_join(0));
  EXPECT_EQ(sequences(follower.take(key(4))), Numbers{});
  EXPECT_EQ(sequences(follower.take(join(3))), (Numbers{3, 4}));
}

TEST(Follower, AForgedKeyFarAheadCostsOneJoin) {
  Follower follower(kEpoch);
  (void)follower.take(join(1));
  EXPECT_EQ(sequences(follower.take(key(std::uint64_t{1} << 63))), Numbers{});
  EXPECT_EQ(sequences(follower.take(key(2))), Numbers{});
  EXPECT_TRUE(follower.wants_join(0));
  EXPECT_EQ(sequences(follower.take(join(3))), Numbers{3});
  EXPECT_EQ(sequences(follower.take(key(4))), Numbers{4});
  EXPECT_FALSE(follower.wants_join(1'000'000'000));
}

TEST(Follower, KeptBytesAreBounded) {
  Follower follower(kEpoch);
  for (std::uint64_t i = 1; i <= 20; ++i) {
    Bytes large = key(i);
    large.resize(1'000'000);
    (void)follower.take(std::move(large));
  }
  EXPECT_EQ(follower.dropped(), 16U);
  EXPECT_EQ(sequences(follower.take(join(16))), (Numbers{16, 17, 18, 19, 20})) << "the newest are there";
}

TEST(Follower, StaleJoinIsDropped) {
  Follower follower(kEpoch);
  (void)follower.take(join(5));
  follower.restart();
  EXPECT_EQ(sequences(follower.take(join(5))), Numbers{});
  EXPECT_EQ(sequences(follower.take(join(4))), Numbers{});
  EXPECT_EQ(sequences(follower.take(join(6))), Numbers{6});
}

TEST(Follower, OtherEpochsAndKindsAreDropped) {
  Follower follower(kEpoch);
  (void)follower.take(join(1));
  EXPECT_TRUE(follower.take(message(FrameKind::kKey, 2, kEpoch - 1)).empty());
  EXPECT_TRUE(follower.take(message(FrameKind::kJoin, 9, kEpoch + 1)).empty());
  Bytes step = key(2);
  step[Follower::kHeadBytes] = static_cast<std::uint8_t>(FrameKind::kStep);
  step[Follower::kHeadBytes + 4] = 0x13;
  EXPECT_TRUE(follower.take(std::move(step)).empty());
  EXPECT_TRUE(follower.take({}).empty());
  EXPECT_TRUE(follower.take(Bytes(27, 1)).empty());
  EXPECT_EQ(follower.dropped(), 5U);
  EXPECT_EQ(sequences(follower.take(key(2))), Numbers{2});
}

TEST(Follower, KeepsABoundedNumberOfKeys) {
  Follower follower(kEpoch);
  for (std::uint64_t s = 1; s <= 1000; ++s) EXPECT_TRUE(follower.take(key(s)).empty());
  EXPECT_EQ(follower.dropped(), 1000 - Follower::kMaxKept);
  EXPECT_EQ(follower.take(join(990)).size(), 11U);
}

// The output is always a chain: it begins with a join, and every key follows its predecessor.
TEST(Follower, OutputIsAlwaysAChain) {
  std::mt19937 random(7);
  for (int run = 0; run < 200; ++run) {
    Follower follower(kEpoch);
    std::uint64_t sent = 0, newest = 0;
    bool began = false;
    for (int i = 0; i < 300; ++i) {
      Bytes next;
      switch (random() % 8) {
        case 0:
          next = join(sent);  // The answer to a request, of whenever.
          break;
        case 1:
          next = join(sent > 3 ? sent - random() % 4 : sent);
          break;
        case 2:
          sent += 1 + random() % 3;  // Lost.
          continue;
        default:
          next = key(++sent);
      }
      for (const auto& [sequence, bytes, frame] : follower.take(std::move(next))) {
        Envelope head = frame.envelope;
        if (head.kind == FrameKind::kKey) {
          ASSERT_TRUE(began);
          head.sequence = newest + 1;
          ASSERT_EQ(frame.check, static_cast<std::uint8_t>(head.sequence));
        } else {
          ASSERT_TRUE(!began || head.sequence > newest);
        }
        began = true;
        newest = head.sequence;
      }
    }
    EXPECT_TRUE(began);
  }
}

}  // namespace
}  // namespace eigencast::broker
