// SPDX-License-Identifier: MIT
#include "common/codec/memory_keeper.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <random>

#include "tests/unit/codec/motion_sample.h"

namespace eigencast {
namespace {

constexpr std::uint8_t kStep = 158, kHalfSpacing = 6;
constexpr TimeUs kGapUs = 33'333;

/// Never the same again: each value moves at a frequency of its own.
Key novel(const CoefficientLayout& layout, double time) {
  std::vector<double> C(layout.size());
  for (std::size_t i = 0; i < C.size(); ++i) {
    const auto row = static_cast<double>(i / layout.channels);
    const double speed = 0.05 + 0.1 * std::fmod(static_cast<double>(i) * 0.618034, 1.0);
    C[i] = 6000 / (1 + 0.2 * row) * std::sin(speed * time + static_cast<double>(i)) +
           400 * std::sin(2.3 * speed * time + static_cast<double>(i * i % 17));
  }
  return key_from_coefficients(layout, C, kStep).value();
}

/// A stream with a keeper and receivers that hold its segments `latency` keys later, and the same stream without.
class LiveStream {
 public:
  explicit LiveStream(MemoryKeeper::Options options, int latency = 6)
      : layout_(options.layout), keeper(options), latency_(latency) {}

  void send(const Key& key) {
    const TimeUs now = kGapUs * ++frames;
    if (!state_) {
      state_ = plain_ = advanced(std::nullopt, key, 0);
      return;
    }
    if (wait_ > 0 && --wait_ == 0) hold();
    const ChainState before = *state_;
    const CodedKey coded = recaller_ ? recaller_->encode(before, key, kHalfSpacing).value()
                                     : encode_key(layout_, before, key, kHalfSpacing).value();
    state_ = advanced(before, coded.key, kGapUs, coded.phase);
    recalled += coded.phase ? 1 : 0;
    bits += static_cast<double>(coded.payload.size()) * 8;
    const CodedKey plain = encode_key(layout_, *plain_, key, kHalfSpacing).value();
    plain_ = advanced(plain_, plain.key, kGapUs);
    plain_bits += static_cast<double>(plain.payload.size()) * 8;
    if (!keeper.add({before, key, coded.payload.size(), coded.phase, kHalfSpacing, now, wait_ == 0})) return;
    ++changes;
    if (first_change_us == 0) first_change_us = now;
    side_bits += static_cast<double>(keeper.segments().back().bytes.size()) * 8;
    published.emplace_back(now, static_cast<double>(keeper.segments().back().bytes.size()) * 8);
    wait_ = latency_;
  }
  double in_all() const { return bits + side_bits; }
  std::uint64_t poses() const {
    std::uint64_t poses = 0;
    for (const CodedSegment& segment : keeper.segments()) poses += segment.segment->poses;
    return poses;
  }

 private:
  CoefficientLayout layout_;

 public:
  MemoryKeeper keeper;
  TimeUs frames = 0, first_change_us = 0;
  double bits = 0, plain_bits = 0, side_bits = 0;
  int recalled = 0, changes = 0;
  std::vector<std::pair<TimeUs, double>> published;

 private:
  void hold() {
    PoseMemory memory(layout_);
    for (const CodedSegment& segment : keeper.segments()) memory = memory.with(segment.segment).value();
    if (keeper.segments().size() <= held_) state_->phase.reset();
    held_ = keeper.segments().size();
    recaller_.emplace(std::move(memory));
  }

  int latency_, wait_ = 0;
  std::size_t held_ = 0;
  std::optional<ChainState> state_, plain_;
  std::optional<Recaller> recaller_;
};

class MemoryKeeperTest : public testing::Test {
 protected:
  CoefficientLayout layout = layout_of(CodecKind::kQuantised, 60);
  /// Poses first, first + 1, ... of novel motion, `length` of them in a loop.
  void loop(LiveStream& stream, int first, int length, int keys) const {
    for (int i = 0; i < keys; ++i) stream.send(novel(layout, first + i % length));
  }
  double stake(const LiveStream& stream) const {
    return stream.plain_bits / static_cast<double>(stream.frames) * MemoryKeeper::kStakeUs / kGapUs;
  }
};

TEST_F(MemoryKeeperTest, LoopIsRememberedWhenItComesAgain) {
  LiveStream stream({layout});
  loop(stream, 0, 90, 90);
  EXPECT_EQ(stream.changes, 0) << "nothing has come again yet";
  loop(stream, 0, 90, 1800 - 90);
  EXPECT_LE(stream.first_change_us, kGapUs * (90 + 75)) << "within the second pass";
  EXPECT_LE(stream.poses(), 100u) << "once";
  EXPECT_LT(stream.in_all(), 0.4 * stream.plain_bits);
}

TEST_F(MemoryKeeperTest, LongLoopIsRememberedAheadOfItself) {
  LiveStream stream({layout});
  loop(stream, 0, 600, 600 * 6);
  EXPECT_GE(stream.poses(), 560u);
  EXPECT_LE(stream.poses(), 660u);
  EXPECT_LT(stream.in_all(), 0.75 * stream.plain_bits);
}

TEST_F(MemoryKeeperTest, NewMotionIsNotRemembered) {
  LiveStream stream({layout});
  loop(stream, 0, 100'000, 1800);
  EXPECT_LE(stream.in_all(), 1.01 * stream.plain_bits);
  EXPECT_EQ(stream.changes, 0);
}

TEST_F(MemoryKeeperTest, HeldPosesAreNotRemembered) {
  for (const bool at_once : {false, true}) {
    LiveStream stream({.layout = layout, .at_once = at_once});
    loop(stream, 7, 1, 900);
    EXPECT_EQ(stream.changes, 0);
  }
}

TEST_F(MemoryKeeperTest, StopAndGoLeavesHeldPosesOut) {
  LiveStream stream({layout});
  for (int pass = 0; pass < 6; ++pass) {
    loop(stream, 0, 90, 90);
    for (int i = 0; i < 200; ++i) stream.send(novel(layout, 89));
  }
  EXPECT_GE(stream.poses(), 80u);
  EXPECT_LE(stream.poses(), 110u);
}

TEST_F(MemoryKeeperTest, MotionThatComesTwiceAndNeverAgainCostsAHundredthAndAStake) {
  LiveStream stream({layout});
  // 1.2 s, again, then something else: as soon as it is remembered it is of no use any more.
  for (int motion = 0; motion < 60; ++motion) loop(stream, 1000 * motion, 36, 72);
  EXPECT_GT(stream.changes, 0);
  EXPECT_LE(stream.in_all(), 1.01 * stream.plain_bits + 1.1 * stake(stream));
}

TEST_F(MemoryKeeperTest, SegmentsTakeAtMostAFifthOfTheBitrateInAnyMinute) {
  MemoryKeeper::Options options{layout};
  options.bitrate = 20'000;
  for (const bool at_once : {false, true}) {
    options.at_once = at_once;
    LiveStream stream(options);
    for (int motion = 0; motion < 8; ++motion) loop(stream, 1000 * motion, 40, 600);
    EXPECT_GT(stream.changes, 2);
    for (const auto& [from, first] : stream.published) {
      double lately = 0;
      for (const auto& [at, bits] : stream.published) lately += at >= from && at < from + 60'000'000 ? bits : 0;
      EXPECT_LE(lately, 0.2 * options.bitrate * 60);
    }
    EXPECT_LE(stream.published.front().second,
              0.2 * options.bitrate * 1e-6 * static_cast<double>(stream.published.front().first));
  }
}

TEST_F(MemoryKeeperTest, AllThatIsNewIsRememberedAtOnceWhereAskedFor) {
  LiveStream stream({.layout = layout, .at_once = true});
  loop(stream, 0, 90, 90);
  EXPECT_GE(stream.poses(), 55u) << "before anything comes again";
  loop(stream, 0, 90, 300);
  EXPECT_LE(stream.poses(), 120u);
}

TEST_F(MemoryKeeperTest, LimitsHoldAndWhatIsOfUseStays) {
  // 164 kB a pose: 51 fit.
  const CoefficientLayout large = layout_of(CodecKind::kQuantised, 4096, 10);
  LiveStream stream({.layout = large, .at_once = true});
  int roots = 0;
  std::size_t segments = 0;
  for (int i = 0; i < 400; ++i) {
    const int changes = stream.changes;
    stream.send(novel(large, i));
    roots += stream.changes > changes && stream.keeper.segments().size() <= segments ? 1 : 0;
    segments = stream.keeper.segments().size();
    ASSERT_TRUE(PoseMemory::check_size(large, stream.poses())) << i;
  }
  EXPECT_GT(stream.changes, 4);
  EXPECT_GT(roots, 0);
}

TEST_F(MemoryKeeperTest, MostUsedSegmentOutlivesNewRoots) {
  LiveStream stream({.layout = layout, .at_once = true});
  loop(stream, 0, 60, 400);
  ASSERT_FALSE(stream.keeper.segments().empty());
  const auto first = stream.keeper.segments().front().segment;
  std::uint64_t most = 0;
  for (int motion = 1; motion < 30; ++motion) {
    loop(stream, 1000 * motion, 50, 50);
    loop(stream, 0, 60, 60);
    most = std::max(most, stream.poses());
  }
  EXPECT_LE(most, PoseMemory::kMaxPoses);
  EXPECT_GT(most, PoseMemory::kMaxPoses / 2);
  EXPECT_LT(stream.poses(), most) << "a new root";
  EXPECT_EQ(stream.keeper.segments().front().segment, first);
}

TEST_F(MemoryKeeperTest, NothingIsSaidWhileReceiversDoNotHoldTheLast) {
  LiveStream stream({.layout = layout, .at_once = true}, 1'000'000);
  loop(stream, 0, 100'000, 600);
  EXPECT_EQ(stream.changes, 1);
}

TEST_F(MemoryKeeperTest, RestoredMemoryIsNotRememberedAgain) {
  LiveStream stream({.layout = layout, .at_once = true});
  loop(stream, 0, 90, 300);
  auto segments = stream.keeper.segments();
  ASSERT_FALSE(segments.empty());
  MemoryKeeper next({layout});
  ASSERT_TRUE(next.restore(segments));
  EXPECT_EQ(next.segments().size(), segments.size());
  segments.resize(2000, segments.front());
  EXPECT_EQ(next.restore(segments).error().code, ErrorCode::kTooLarge);
}

TEST_F(MemoryKeeperTest, ChangesOfStepAndMissingBandsAreSafe) {
  LiveStream stream({.layout = layout, .at_once = true});
  for (int i = 0; i < 300; ++i) {
    Key key = novel(layout, i % 50);
    if (i / 60 % 2 == 1) {
      const auto C = coefficients_from_key(layout, key);
      key = key_from_coefficients(layout, C, kStep + 1).value();
    }
    if (i % 97 == 96) key.bands = 1, std::fill(key.q.begin() + layout.range(0).second, key.q.end(), 0);
    stream.send(key);
  }
  for (const CodedSegment& segment : stream.keeper.segments())
    EXPECT_TRUE(decode_segment(layout, AssetDigest{}, segment.bytes));
}

}  // namespace
}  // namespace eigencast
