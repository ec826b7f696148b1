// SPDX-License-Identifier: MIT
#include "common/wire/envelope.h"

#include <gtest/gtest.h>

#include <memory>

#include "common/wire/limits.h"

namespace eigencast {
namespace {

Envelope sample(FrameKind kind) {
  Envelope envelope;
  envelope.kind = kind;
  envelope.bands = kind == FrameKind::kStep ? 0 : 0x0f;
  if (kind == FrameKind::kSynthetic || kind == FrameKind::kStep) envelope.step = {2, 3};
  envelope.stream_id = 0x01020304;
  envelope.epoch = 0x05060708;
  envelope.sequence = 0x1112131415161718;
  envelope.capture_us = 0x2122232425262728;
  return envelope;
}

Bytes frame_of(const Envelope& envelope, const Bytes& payload) {
  Bytes frame;
  append_envelope(envelope, frame);
  frame.insert(frame.end(), payload.begin(), payload.end());
  return frame;
}

TEST(Envelope, GoldenBytes) {
  const Bytes expected = {3,    0x0f, 0x23, 0x04, 0x03, 0x02, 0x01, 0x08, 0x07, 0x06, 0x05, 0x18, 0x17, 0x16,
                          0x15, 0x14, 0x13, 0x12, 0x11, 0x28, 0x27, 0x26, 0x25, 0x24, 0x23, 0x22, 0x21};
  EXPECT_EQ(frame_of(sample(FrameKind::kSynthetic), {}), expected);
  EXPECT_EQ(expected.size(), Envelope::kBytes);
}

TEST(Envelope, EachKindRoundTrips) {
  for (const FrameKind kind : {FrameKind::kKey, FrameKind::kJoin, FrameKind::kSynthetic, FrameKind::kStep}) {
    for (const std::uint8_t flags : {std::uint8_t{0}, Envelope::kAhead}) {
      if (flags != 0 && kind != FrameKind::kKey && kind != FrameKind::kJoin) continue;
      Envelope envelope = sample(kind);
      envelope.flags = flags;
      const Bytes payload = kind == FrameKind::kStep ? Bytes{} : Bytes{9, 8, 7};
      const Bytes frame = frame_of(envelope, payload);
      const auto parsed = parse_frame(frame);
      ASSERT_TRUE(parsed) << parsed.error().message;
      EXPECT_EQ(parsed->envelope, envelope);
      EXPECT_EQ(Bytes(parsed->payload.begin(), parsed->payload.end()), payload);
    }
  }
}

TEST(Envelope, EveryTruncationIsRejected) {
  const Bytes frame = frame_of(sample(FrameKind::kStep), {});
  for (std::size_t size = 0; size < frame.size(); ++size) {
    const std::unique_ptr<std::uint8_t[]> exact(new std::uint8_t[size]);
    std::copy_n(frame.begin(), size, exact.get());
    EXPECT_EQ(parse_frame(ByteView(exact.get(), size)).error().code, ErrorCode::kCorrupt) << size;
  }
}

/// The frame with one byte of the envelope replaced.
Result<FrameView> with_byte(FrameKind kind, std::size_t offset, std::uint8_t value) {
  static Bytes frame;
  frame = frame_of(sample(kind), kind == FrameKind::kStep ? Bytes{} : Bytes{1});
  frame[offset] = value;
  return parse_frame(frame);
}

TEST(Envelope, UnknownKindsAndReservedFlagsAreRejected) {
  // With bands, a payload and no step the frame can be a key or a join, with or without the flag `ahead`, and no more.
  for (int first = 0; first < 256; ++first) {
    const bool known = first == 1 || first == 2 || first == (1 | 8) || first == (2 | 8);
    EXPECT_EQ(with_byte(FrameKind::kKey, 0, static_cast<std::uint8_t>(first)).has_value(), known) << first;
  }
  for (int flags = 1; flags < 32; ++flags) {
    const auto byte = [flags](FrameKind kind) {
      return static_cast<std::uint8_t>(static_cast<int>(kind) | flags << 3);
    };
    EXPECT_FALSE(with_byte(FrameKind::kSynthetic, 0, byte(FrameKind::kSynthetic)));
    EXPECT_FALSE(with_byte(FrameKind::kStep, 0, byte(FrameKind::kStep)));
  }
}

TEST(Envelope, StepMustSuitTheKind) {
  for (int step = 0; step < 256; ++step) {
    const auto byte = static_cast<std::uint8_t>(step);
    const bool between = (step >> 4) >= 1 && (step >> 4) <= (step & 15);
    EXPECT_EQ(with_byte(FrameKind::kKey, 2, byte).has_value(), step == 0);
    EXPECT_EQ(with_byte(FrameKind::kSynthetic, 2, byte).has_value(), between) << step;
    EXPECT_EQ(with_byte(FrameKind::kStep, 2, byte).has_value(), between) << step;
  }
}

TEST(Envelope, BandsAndPayloadBelongTogether) {
  EXPECT_FALSE(with_byte(FrameKind::kKey, 1, 0));
  EXPECT_FALSE(with_byte(FrameKind::kStep, 1, 1));
  EXPECT_FALSE(parse_frame(frame_of(sample(FrameKind::kKey), {})));
  EXPECT_FALSE(parse_frame(frame_of(sample(FrameKind::kStep), {0})));
}

TEST(Envelope, LimitsOfSizeAndTime) {
  EXPECT_FALSE(with_byte(FrameKind::kKey, 26, 0x40));
  EXPECT_TRUE(with_byte(FrameKind::kKey, 26, 0x3f));
  Bytes frame = frame_of(sample(FrameKind::kKey), {});
  frame.resize(limits::kMaxFrameBytes);
  EXPECT_TRUE(parse_frame(frame));
  frame.push_back(0);
  EXPECT_EQ(parse_frame(frame).error().code, ErrorCode::kTooLarge);
}

}  // namespace
}  // namespace eigencast
