// SPDX-License-Identifier: MIT
#include "sdk/recorded_stream.h"

#include <gtest/gtest.h>

#include "common/core/files.h"
#include "common/recording/writer.h"
#include "tests/support/process.h"

namespace eigencast {
namespace {

constexpr TimeUs kInterval = 40'000;
const Sha256 kSurface = sha256(Bytes{1});

/// A recording whose first pose is a join, whose others are predicted from a memory of two segments.
class RecordedStreams : public ::testing::Test {
 protected:
  RecordedStreams() {
    for (int s = 0; s < 2; ++s) {
      const std::vector<Key> poses{key(4 * s + 1), key(4 * s + 2), key(4 * s + 3)};
      segments_.push_back(encode_segment(layout_, kSurface.digest, poses, 1).value());
      memory_ = memory_.with(segments_.back().segment).value();
    }
    state_ = advanced(std::nullopt, key(1), 0);
    sent_.push_back(key(1));
  }

  Key key(int number) const {
    Key k;
    k.bands = 3;
    k.step = 100;
    for (int i = 0; i < 60; ++i) k.q.push_back((number * number * (i + 1)) % 211 + 3 * i - 90);
    return k;
  }
  Bytes ids(std::size_t count) const {
    Bytes result;
    for (std::size_t s = 0; s < count; ++s) {
      const auto digest = sha256(segments_[s].bytes).digest;
      result.insert(result.end(), digest.begin(), digest.end());
    }
    return result;
  }
  void announce(recording::Writer& writer, std::size_t segments) {
    control::Announce announce;
    announce.asset = kSurface.hex();
    announce.format = {20, 3, {14, 20}, "quantised"};
    announce.key_rate_hz = 25;
    ASSERT_TRUE(writer.announce(now_us(), text_from_control(announce), ids(segments)));
    ASSERT_TRUE(writer.checkpoint(now_us(), frame(FrameKind::kJoin, encode_join(layout_, state_).value())));
  }
  Bytes frame(FrameKind kind, const Bytes& payload) {
    Envelope envelope;
    envelope.kind = kind;
    envelope.flags = state_.phase ? Envelope::kRecalled : std::uint8_t{0};
    envelope.bands = layout_.all_bands();
    envelope.sequence = sequence_;
    envelope.capture_us = now_us();
    envelope.age_us = sequence_ > 1 ? kInterval : 0;
    Bytes bytes;
    append_envelope(envelope, &newest_, bytes);
    newest_ = ChainClock::after(envelope);
    bytes.insert(bytes.end(), payload.begin(), payload.end());
    return bytes;
  }
  void recalled(recording::Writer& writer, int number, std::uint32_t phase) {
    const CodedKey coded = encode_recalled_key(layout_, state_, memory_, phase, key(number), 3).value();
    state_ = advanced(std::move(state_), coded.key, kInterval, coded.phase);
    sent_.push_back(coded.key);
    ++sequence_;
    ASSERT_TRUE(writer.frame(now_us(), frame(FrameKind::kKey, coded.payload)));
  }
  TimeUs now_us() const { return static_cast<TimeUs>(sequence_) * kInterval; }

  void write(std::size_t objects, std::size_t remembered) {
    auto writer = recording::Writer::create(path_, {"lab/ball", "test", 0}).value();
    for (std::size_t s = 0; s < objects; ++s)
      ASSERT_TRUE(writer.object(0, sha256(segments_[s].bytes).digest, segments_[s].bytes));
    announce(writer, remembered);
    recalled(writer, 2, 0);
    recalled(writer, 3, 8);
    state_.phase.reset();  // the next memory may have other poses
    announce(writer, remembered);
    recalled(writer, 6, 24);
    ASSERT_TRUE(writer.finish());
  }
  struct Read {
    std::vector<Key> poses;
    std::vector<TimeUs> captures_us;
    int announcements = 0, memories = 0;
    std::optional<ErrorCode> error;
  };
  Read read(TimeUs from_us = 0) {
    Read result;
    auto stream = RecordedStream::open(path_).value();
    EXPECT_TRUE(stream.seek(from_us));
    for (;;) {
      auto event = stream.next();
      if (!event) result.error = event.error().code;
      if (!event || !*event) return result;
      result.announcements += std::holds_alternative<control::Announce>((**event).what) ? 1 : 0;
      if (const auto* memory = std::get_if<RecordedStream::Memory>(&(**event).what)) {
        ++result.memories;
        for (std::size_t s = 0; s < memory->size(); ++s) EXPECT_EQ((*memory)[s].bytes, segments_[s].bytes);
      }
      if (const auto* pose = std::get_if<RecordedPose>(&(**event).what)) {
        EXPECT_EQ(pose->coded.empty(), !pose->phase) << "joins are not coded as keys are";
        result.poses.push_back(pose->key);
        result.captures_us.push_back(pose->capture_us);
      }
    }
  }

  const testing::TemporaryFolder folder_;
  const std::string path_ = folder_.file("a.ecrec");
  const CoefficientLayout layout_{CodecKind::kQuantised, 20, 3, {14, 20}};
  std::vector<CodedSegment> segments_;
  PoseMemory memory_{layout_};
  ChainState state_;
  ChainClock newest_;
  std::uint64_t sequence_ = 1;
  std::vector<Key> sent_;  ///< As receivers decode them.
};

TEST_F(RecordedStreams, KeysAreReadWithTheMemoryThatTheyNeed) {
  write(2, 2);
  const Read all = read();
  EXPECT_FALSE(all.error);
  EXPECT_EQ(all.poses, sent_) << "a checkpoint of what is there is none";
  EXPECT_EQ(all.captures_us, (std::vector<TimeUs>{kInterval, 2 * kInterval, 3 * kInterval, 4 * kInterval}));
  EXPECT_EQ(all.announcements, 2);
  EXPECT_EQ(all.memories, 2);
}

TEST_F(RecordedStreams, AreReadFromAnyCheckpointOn) {
  write(2, 2);
  EXPECT_EQ(read(7 * kInterval / 2).poses, (std::vector{sent_[2], sent_[3]}));
}

TEST_F(RecordedStreams, WhatTheMemoryLacksIsAnError) {
  write(1, 2);
  EXPECT_EQ(read().error, ErrorCode::kCorrupt) << "a segment that the recording lacks";
  EXPECT_TRUE(read().poses.empty());
}

TEST_F(RecordedStreams, KeysWithoutTheirMemoryAreAnError) {
  write(2, 0);
  EXPECT_EQ(read().error, ErrorCode::kCorrupt);
  EXPECT_EQ(read().poses, std::vector{key(1)});
}

TEST_F(RecordedStreams, HoldObjectsByTheirHash) {
  write(2, 2);
  auto stream = RecordedStream::open(path_).value();
  EXPECT_EQ(stream.object(sha256(segments_[1].bytes)).value(), segments_[1].bytes);
  EXPECT_EQ(stream.object(kSurface).error().code, ErrorCode::kNotFound);
}

}  // namespace
}  // namespace eigencast
