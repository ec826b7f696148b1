// SPDX-License-Identifier: MIT
#include "sdk/frame_decoder.h"

#include <gtest/gtest.h>

namespace eigencast {
namespace {

constexpr std::uint32_t kRows = 20;

control::StreamInfo live_stream(std::uint32_t epoch = 5) {
  control::StreamInfo info;
  info.stream = "a";
  info.state = control::StreamInfo::State::kLive;
  info.stream_id = 3;
  info.epoch = epoch;
  info.asset = std::string(64, 'a');
  info.format = {kRows, 3, {14, kRows}, "quantised"};
  return info;
}

struct CodedFrame {
  Envelope envelope;
  Bytes payload;
  FrameView view() const { return {envelope, payload}; }
};

/// Codes a made-up motion as a broker would.
class Coder {
 public:
  explicit Coder(std::uint32_t epoch = 5) : epoch_(epoch) {}

  const CoefficientLayout layout{CodecKind::kQuantised, kRows, 3, {14, kRows}};

  static Key key(std::uint64_t sequence) {
    Key k;
    k.bands = 3;
    k.step = 100;
    k.q.resize(kRows * 3);
    for (std::size_t i = 0; i < k.q.size(); ++i)
      k.q[i] = static_cast<std::int32_t>((sequence * sequence * (i + 1)) % 211 + 3 * i) - 90;
    return k;
  }

  CodedFrame next_key(std::uint8_t flags = 0, InterpolationStep shows = {}) {
    const Key k = key(++sequence_);
    Bytes payload = state_ ? encode_key(layout, *state_, k, 0)->payload : Bytes();
    const bool join = !state_;
    state_ = advanced(std::move(state_), k, join ? 0 : 33'333);
    if (join) payload = *encode_join(layout, *state_);
    return frame(join ? FrameKind::kJoin : FrameKind::kKey, flags, shows, payload, sequence_);
  }
  CodedFrame join(std::uint8_t flags = 0, InterpolationStep shows = {}) {
    return frame(FrameKind::kJoin, flags, shows, *encode_join(layout, *state_), sequence_);
  }
  /// A step to `pose`.
  CodedFrame residual(std::uint8_t at, std::uint8_t of, const Key& pose) {
    const Key base = *interpolate_keys(layout, state_->older, state_->newer, at, of);
    const auto coded = *encode_residual(layout, base, pose, 0);
    CodedFrame out = frame(FrameKind::kStep, 0, {at, of}, coded.payload, sequence_);
    out.envelope.bands = coded.bands;
    return out;
  }
  CodedFrame step(std::uint8_t at, std::uint8_t of) { return frame(FrameKind::kStep, 0, {at, of}, {}, sequence_); }
  std::uint64_t sequence() const { return sequence_; }

 private:
  CodedFrame frame(FrameKind kind, std::uint8_t flags, InterpolationStep step, const Bytes& payload,
                   std::uint64_t sequence) const {
    Envelope e;
    e.kind = kind;
    e.flags = flags;
    e.bands = kind == FrameKind::kStep ? 0 : 3;
    e.step = step;
    e.stream_id = 3;
    e.epoch = epoch_;
    e.sequence = sequence;
    e.capture_us = static_cast<TimeUs>(sequence) * 33'333;
    return {e, payload};
  }
  std::uint32_t epoch_;
  std::uint64_t sequence_ = 0;
  std::optional<ChainState> state_;
};

class Decoding : public ::testing::Test {
 protected:
  Decoding() { decoder_.set_stream(live_stream()); }
  std::optional<Key> decode(const CodedFrame& frame) {
    auto pose = decoder_.decode(frame.view());
    EXPECT_TRUE(pose) << pose.error().message;
    return pose && *pose ? std::optional(**pose) : std::nullopt;
  }
  FrameDecoder decoder_;
  Coder coder_;
};

TEST_F(Decoding, KeysOfAChainRoundTrip) {
  for (std::uint64_t s = 1; s <= 20; ++s) ASSERT_EQ(decode(coder_.next_key()), Coder::key(s));
  EXPECT_EQ(decoder_.counts().keys, 20u);
  EXPECT_EQ(decoder_.counts().joins, 1u);
  EXPECT_EQ(decoder_.counts().missed, 0u);
  EXPECT_EQ(decoder_.counts().rejected, 0u);
}

TEST_F(Decoding, KeyAfterAGapNeedsAJoin) {
  decode(coder_.next_key());
  coder_.next_key();
  EXPECT_FALSE(decode(coder_.next_key()));
  EXPECT_FALSE(decode(coder_.next_key()));
  EXPECT_EQ(decoder_.counts().rejected, 2u);
  EXPECT_EQ(decode(coder_.join()), Coder::key(4));
  EXPECT_EQ(decode(coder_.next_key()), Coder::key(5));
  EXPECT_EQ(decoder_.counts().missed, 2u);
}

TEST_F(Decoding, ResidualsMakeAnyPose) {
  decode(coder_.next_key());
  const Key pose = *interpolate_keys(coder_.layout, Coder::key(2), Coder::key(5), 1, 3);
  EXPECT_FALSE(decode(coder_.next_key(Envelope::kAhead)));
  const CodedFrame step = coder_.residual(1, 3, pose);
  EXPECT_EQ(decode(step), pose);
  EXPECT_EQ(decode(coder_.step(1, 3)), *interpolate_keys(coder_.layout, Coder::key(1), Coder::key(2), 1, 3));
  CodedFrame bad = step;
  bad.payload.pop_back();
  EXPECT_FALSE(decoder_.decode(bad.view()));
  const CodedFrame lost = coder_.next_key();
  EXPECT_FALSE(decode(coder_.step(2, 3)));
  EXPECT_EQ(decode(lost), Coder::key(3)) << "an undecodable step leaves the chain alone";
}

TEST_F(Decoding, KeysSentAheadShowAStepOrNothing) {
  decode(coder_.next_key());
  EXPECT_EQ(decoder_.take_ahead(), nullptr);
  EXPECT_FALSE(decode(coder_.next_key(Envelope::kAhead)));
  ASSERT_NE(decoder_.take_ahead(), nullptr);
  EXPECT_EQ(decoder_.take_ahead(), nullptr) << "taken";
  EXPECT_EQ(decode(coder_.step(1, 3)), *interpolate_keys(coder_.layout, Coder::key(1), Coder::key(2), 1, 3));
  EXPECT_EQ(decode(coder_.step(3, 3)), Coder::key(2));
  const CodedFrame late = coder_.step(3, 3);
  EXPECT_EQ(decode(coder_.next_key(Envelope::kAhead, {1, 3})),
            *interpolate_keys(coder_.layout, Coder::key(2), Coder::key(3), 1, 3));
  EXPECT_EQ(*decoder_.take_ahead(), Coder::key(3));
  EXPECT_FALSE(decode(late)) << "a step of the interval before";
  EXPECT_EQ(decoder_.counts().synthetic, 3u);
  decoder_.restart();
  EXPECT_EQ(decode(coder_.join(Envelope::kAhead, {2, 3})),
            *interpolate_keys(coder_.layout, Coder::key(2), Coder::key(3), 2, 3));
}

/// Keys of a memory: what Coder::key makes, remembered four keys at a time.
class DecodingFromMemory : public Decoding {
 protected:
  DecodingFromMemory() {
    constexpr AssetDigest kAsset{9};
    for (std::uint64_t first = 1; first < 9; first += 4) {
      std::vector<Key> keys;
      for (std::uint64_t s = first; s < first + 4; ++s) keys.push_back(Coder::key(s));
      memory_ = memory_.with(encode_segment(coder_.layout, kAsset, keys, 1).value().segment).value();
    }
    state_ = advanced(std::nullopt, Coder::key(1), 0);
  }
  CodedFrame join() {
    CodedFrame frame = coder_.join();
    frame.envelope.flags = state_.phase ? Envelope::kRecalled : std::uint8_t{0};
    frame.envelope.sequence = sequence_;
    frame.payload = *encode_join(coder_.layout, state_);
    return frame;
  }
  CodedFrame recalled(std::uint32_t phase) {
    const CodedKey coded =
        encode_recalled_key(coder_.layout, state_, memory_, phase, Coder::key(++sequence_), 3).value();
    state_ = advanced(std::move(state_), coded.key, 33'333, coded.phase);
    CodedFrame frame = coder_.join();
    frame.envelope.kind = FrameKind::kKey;
    frame.envelope.flags = Envelope::kRecalled;
    frame.envelope.sequence = sequence_;
    frame.payload = coded.payload;
    return frame;
  }
  PoseMemory memory_{coder_.layout};
  ChainState state_;
  std::uint64_t sequence_ = 1;
  const CodedFrame first_ = coder_.next_key();
};

TEST_F(DecodingFromMemory, KeysAndJoinsRoundTrip) {
  decoder_.set_memory(memory_);
  decode(first_);
  for (std::uint32_t pose = 1; pose < 8; ++pose) {
    const CodedFrame frame = recalled(8 * pose);
    EXPECT_EQ(decode(frame), state_.newer) << pose;
    FrameDecoder late;
    late.set_stream(live_stream());
    late.set_memory(memory_);
    const auto joined = late.decode(join().view());
    ASSERT_TRUE(joined && *joined);
    EXPECT_EQ(**joined, state_.newer);
    decoder_ = late;
  }
}

TEST_F(DecodingFromMemory, FramesOfAMemoryThatIsNotHereWaitForAPlainJoin) {
  decode(first_);
  EXPECT_EQ(decoder_.decode(recalled(8).view()).error().code, ErrorCode::kCorrupt);
  EXPECT_EQ(decoder_.decode(join().view()).error().code, ErrorCode::kCorrupt);
  EXPECT_FALSE(decoder_.newest());
  PoseMemory less(coder_.layout);
  decoder_.set_memory(less.with(encode_segment(coder_.layout, {}, std::vector{Coder::key(1)}, 1)->segment).value());
  EXPECT_EQ(decoder_.decode(join().view()).error().code, ErrorCode::kCorrupt) << "a phase that it does not have";
  state_.phase.reset();
  EXPECT_EQ(decode(join()), state_.newer);
}

TEST_F(DecodingFromMemory, MemoryEndsWithItsEpoch) {
  decoder_.set_memory(memory_);
  decoder_.set_stream(live_stream(6));
  decoder_.set_stream(live_stream(5));
  decode(first_);
  EXPECT_FALSE(decoder_.decode(recalled(8).view()));
}

/// What the state remembers of one memory means nothing in the next.
TEST_F(DecodingFromMemory, MemoryThatIsForgottenLeavesNoPhase) {
  decoder_.set_memory(memory_);
  decode(first_);
  decode(recalled(40));
  decoder_.set_memory(std::nullopt);
  decoder_.set_memory(memory_);
  state_.phase.reset();
  EXPECT_EQ(decode(recalled(16)), state_.newer);
}

TEST_F(Decoding, JoinIsDecodableAtAnyMoment) {
  for (int i = 0; i < 5; ++i) coder_.next_key();
  EXPECT_EQ(decode(coder_.join()), Coder::key(5));
  decoder_.restart();
  EXPECT_FALSE(decode(coder_.next_key()));
  EXPECT_EQ(decode(coder_.join()), Coder::key(6));
}

/// As where a viewer changes over to another memory, or to another chain.
TEST_F(Decoding, JoinOfTheKeyThatIsShownIsNoOtherPose) {
  EXPECT_TRUE(decode(coder_.next_key()));
  EXPECT_FALSE(decode(coder_.join()));
  EXPECT_TRUE(decode(coder_.next_key()));
  EXPECT_FALSE(decode(coder_.join()));
  EXPECT_EQ(decode(coder_.next_key()), Coder::key(3)) << "the chain goes on from the join";
  EXPECT_EQ(decoder_.counts().keys, 3u);
  EXPECT_EQ(decoder_.counts().joins, 3u);
  EXPECT_EQ(decoder_.counts().rejected, 0u);
}

TEST_F(Decoding, FinerJoinOfAStillStreamIsShown) {
  decode(coder_.next_key());
  CodedFrame finer = coder_.join();
  Key key = Coder::key(1);
  ++key.q.front();
  finer.payload = *encode_join(coder_.layout, {key, key});
  EXPECT_EQ(decode(finer), key);
  EXPECT_EQ(decoder_.counts().keys, 1u);
}

TEST_F(Decoding, JoinOfAKeyThatOnlyCameAheadIsShownOnce) {
  decode(coder_.next_key());
  decode(coder_.next_key(Envelope::kAhead, {1, 3}));
  EXPECT_EQ(decode(coder_.join()), Coder::key(2));
  EXPECT_FALSE(decode(coder_.join()));
  decode(coder_.next_key(Envelope::kAhead, {1, 3}));
  EXPECT_EQ(decode(coder_.step(3, 3)), Coder::key(3));
  EXPECT_FALSE(decode(coder_.join())) << "its last step was the key";
  EXPECT_EQ(decoder_.counts().keys, 3u);
}

TEST_F(Decoding, FramesOfOtherEpochsAreRejected) {
  decode(coder_.next_key());
  Coder next(6);
  const CodedFrame first = next.next_key();
  EXPECT_FALSE(decode(first));
  decoder_.set_stream(live_stream(6));
  EXPECT_FALSE(decoder_.newest());
  EXPECT_EQ(decode(first), Coder::key(1));
}

TEST_F(Decoding, WaitingStreamsDecodeNothing) {
  FrameDecoder fresh;
  const CodedFrame first = coder_.next_key();
  EXPECT_FALSE(*fresh.decode(first.view()));
  EXPECT_EQ(fresh.counts().rejected, 1u);
}

TEST_F(Decoding, DamagedKeyFailsAndJoinRecovers) {
  decode(coder_.next_key());
  CodedFrame damaged = coder_.next_key();
  damaged.payload.push_back(0);
  EXPECT_FALSE(decoder_.decode(damaged.view()));
  EXPECT_FALSE(decode(coder_.next_key()));
  EXPECT_TRUE(decode(coder_.join()));
  EXPECT_EQ(decoder_.counts().rejected, 2u);
}

TEST_F(Decoding, EveryTruncationIsRejected) {
  decode(coder_.next_key());
  const CodedFrame whole = coder_.next_key();
  for (std::size_t size = 0; size < whole.payload.size(); ++size) {
    FrameDecoder decoder = decoder_;
    EXPECT_FALSE(decoder.decode({whole.envelope, ByteView(whole.payload).first(size)})) << size;
  }
}

}  // namespace
}  // namespace eigencast
