// SPDX-License-Identifier: MIT
//
// What a decoder owes to hostile bytes: no truncation, no extra byte and no malformed head is taken; no bit flip
// crashes it.
#include <gtest/gtest.h>

#include <limits>
#include <memory>

#include "common/core/bytes.h"
#include "tests/unit/codec/motion_sample.h"

namespace eigencast {
namespace {

struct Sample {
  CoefficientLayout layout;
  ChainState state;
  Bytes key, join;

  explicit Sample(CodecKind codec) : layout(layout_of(codec, 20)) {
    const MotionSample motion(layout);
    state = motion.state(158);
    key = encode_key(layout, state, motion.key(2, 158), 4).value().payload;
    join = encode_join(layout, state).value();
  }
  /// Decodes from a heap block of exactly the payload's size, so that a sanitizer sees any read beyond it.
  Result<Key> decode(bool is_join, const Bytes& payload) const {
    const std::unique_ptr<std::uint8_t[]> exact(new std::uint8_t[payload.size()]);
    std::copy(payload.begin(), payload.end(), exact.get());
    const ByteView view(exact.get(), payload.size());
    if (!is_join) return decode_key(layout, layout.all_bands(), state, view);
    auto decoded = decode_join(layout, layout.all_bands(), view);
    if (!decoded) return decoded.error();
    return decoded->newer;
  }
  const Bytes& payload(bool is_join) const { return is_join ? join : key; }
};

class Hostile : public testing::TestWithParam<CodecKind> {};
INSTANTIATE_TEST_SUITE_P(Codecs, Hostile,
                         testing::Values(CodecKind::kFloat64, CodecKind::kFloat32, CodecKind::kQuantised),
                         [](const auto& codec) { return std::string(name_of(codec.param)); });

TEST_P(Hostile, EveryTruncationAndEveryExtraByteIsRejected) {
  const Sample sample(GetParam());
  for (const bool is_join : {false, true}) {
    Bytes payload = sample.payload(is_join);
    ASSERT_TRUE(sample.decode(is_join, payload));
    for (std::size_t size = 0; size < payload.size(); ++size) {
      const auto decoded =
          sample.decode(is_join, Bytes(payload.begin(), payload.begin() + static_cast<std::ptrdiff_t>(size)));
      ASSERT_FALSE(decoded) << size;
      EXPECT_EQ(decoded.error().code, ErrorCode::kCorrupt);
    }
    payload.push_back(0);
    EXPECT_FALSE(sample.decode(is_join, payload));
  }
}

TEST_P(Hostile, NoBitFlipCrashesOrLeavesTheRange) {
  const Sample sample(GetParam());
  for (const bool is_join : {false, true}) {
    for (std::size_t bit = 0; bit < sample.payload(is_join).size() * 8; ++bit) {
      Bytes payload = sample.payload(is_join);
      payload[bit / 8] ^= static_cast<std::uint8_t>(1 << bit % 8);
      const auto decoded = sample.decode(is_join, payload);
      if (!decoded) continue;
      EXPECT_EQ(decoded->q.size() + decoded->f.size(), sample.layout.size());
      for (const std::int32_t q : decoded->q) EXPECT_LE(std::abs(std::int64_t{q}), 1 << 30);
      for (const double f : decoded->f) EXPECT_TRUE(std::isfinite(f));
      const Bytes again = encode_key(sample.layout, sample.state, *decoded, 0).value().payload;
      EXPECT_EQ(decode_key(sample.layout, decoded->bands, sample.state, again).value(), *decoded);
    }
  }
}

TEST_P(Hostile, BandsAndCodecsOfAnotherStreamAreRejected) {
  const Sample sample(GetParam());
  for (const std::uint8_t bands : {0, 1, 2, 4, 7, 255}) {
    EXPECT_FALSE(decode_key(sample.layout, bands, sample.state, sample.key)) << int{bands};
    EXPECT_FALSE(decode_join(sample.layout, bands, sample.join)) << int{bands};
    EXPECT_FALSE(cut_bands(sample.layout, false, bands, 1, sample.key)) << int{bands};
  }
  for (const bool is_join : {false, true}) {
    for (int codec = 0; codec < 256; ++codec) {
      if (codec == static_cast<int>(GetParam())) continue;
      Bytes payload = sample.payload(is_join);
      if (!is_join && codec % 4 == static_cast<int>(GetParam()) && GetParam() == CodecKind::kQuantised) continue;
      payload[0] = static_cast<std::uint8_t>(codec);
      EXPECT_FALSE(sample.decode(is_join, payload));
    }
  }
}

TEST_P(Hostile, CutBandsRejectsEveryTruncationAndExtraBytes) {
  const Sample sample(GetParam());
  for (const bool is_join : {false, true}) {
    Bytes payload = sample.payload(is_join);
    for (std::size_t size = 0; size < payload.size(); ++size) {
      EXPECT_FALSE(cut_bands(sample.layout, is_join, sample.layout.all_bands(), 1, ByteView(payload).first(size)));
    }
    payload.push_back(0);
    EXPECT_FALSE(cut_bands(sample.layout, is_join, sample.layout.all_bands(), 1, payload));
  }
}

class OneBand : public testing::Test {
 protected:
  Result<Key> decode(const Bytes& payload) const { return decode_key(layout, 1, state, payload); }
  CoefficientLayout layout{CodecKind::kQuantised, 2, 1, {2}};
  ChainState state;  ///< Empty: nothing to predict from.
};

TEST_F(OneBand, WhatTheFormatAllowsAndNothingElse) {
  // codec 2, step 160, one section: head, bits.
  EXPECT_EQ(decode({2, 160, 1, 0x9f})->q, (std::vector<std::int32_t>{0, 0})) << "all zero";
  EXPECT_EQ(decode({2, 160, 2, 0x80, 0b1101'0000})->q, (std::vector<std::int32_t>{1, -1}))
      << "k = 0: z = 2, then z = 1";
  EXPECT_FALSE(decode({2, 160, 2, 0x80, 0b1101'0001})) << "padding";
  EXPECT_FALSE(decode({2, 160, 3, 0x80, 0b1101'0000, 0})) << "a whole byte of padding";
  EXPECT_FALSE(decode({2, 160, 2, 0x9f, 0})) << "all zero, then a byte";
  EXPECT_FALSE(decode({2, 160, 1, 0xdf})) << "a reserved bit";
  EXPECT_FALSE(decode({2, 160, 0})) << "no head";
  EXPECT_FALSE(decode({2, 160, 1, 0xbf})) << "differences from a key that is not there";
  EXPECT_FALSE(decode({2 | 4 << 2, 160, 2, 31, 0xc4})) << "a coarse run without a key before it";
  EXPECT_FALSE(decode({2, 160, 0x81, 0x00, 0x9f})) << "a length with a superfluous byte";
  EXPECT_FALSE(decode({2, 160, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x01, 0x9f}))
      << "a length of 2^64 - 1";
}

TEST_F(OneBand, CoarseRunsTakeNoMoreAndNoLess) {
  state = {Key{1, 160, {0, 0}, {}}, Key{1, 160, {16, -16}, {}}, 1};
  const std::uint8_t codec = 2 | 4 << 2;
  EXPECT_EQ(decode({codec, 160, 2, 31, 0xc4})->q, (std::vector<std::int32_t>{16, -16})) << "held";
  EXPECT_EQ(decode({codec, 160, 2, 31, 0xcc})->q, (std::vector<std::int32_t>{32, -32})) << "going on";
  EXPECT_EQ(decode({codec, 160, 2, 31, 0x44})->q, (std::vector<std::int32_t>{8, -8})) << "drawn back";
  EXPECT_FALSE(decode({2, 160, 2, 31, 0xc4})) << "no spacing";
  EXPECT_FALSE(decode({codec, 160, 1, 31})) << "no weights";
  EXPECT_FALSE(decode({codec, 160, 3, 31, 0xc4, 1})) << "all zero, then a byte";
  for (const std::uint8_t reserved : {0x20, 0x40}) {
    EXPECT_FALSE(decode({codec, 160, 2, static_cast<std::uint8_t>(reserved | 31), 0xc4})) << "a reserved bit";
  }
  EXPECT_EQ(decode({codec, 160, 3, 10, 0xc4, 0xff})->q, (std::vector<std::int32_t>{16, -16})) << "0 follows the end";
  EXPECT_FALSE(decode({codec, 160, 4, 10, 0xc4, 0xff, 0})) << "a 0 at the end is left out";
  EXPECT_FALSE(decode({codec, 160, 9, 10, 0xc4, 0xff, 1, 1, 1, 1, 1, 1})) << "bytes that no value needs";
  EXPECT_FALSE(decode({codec, 160, 2, 10, 0xc4})) << "levels without end";
}

TEST_F(OneBand, TheWorkedExampleOfTheProtocolDocument) {
  state = advanced(std::nullopt, Key{1, 160, {10, -10}, {}}, 0);
  const Bytes payload{0x02, 0xa0, 0x02, 0xa2, 0xab};
  EXPECT_EQ(decode(payload)->q, (std::vector<std::int32_t>{13, -14}));
}

TEST_F(OneBand, ValuesBeyondTheRangeAreRejected) {
  const auto escaped = [](std::uint32_t value) {
    Bytes payload{2, 160, 9, 0x80, 0xff, 0xff, 0xff};
    for (int shift = 24; shift >= 0; shift -= 8) payload.push_back(static_cast<std::uint8_t>(value >> shift));
    payload.push_back(0);
    return payload;
  };
  EXPECT_EQ(decode(escaped(1u << 30))->q[0], 1 << 30);
  EXPECT_EQ(decode(escaped(0xc0000000u))->q[0], -(1 << 30));
  EXPECT_FALSE(decode(escaped((1u << 30) + 1)));
  EXPECT_FALSE(decode(escaped(0x80000000u)));
}

TEST_F(OneBand, AReferenceThatOverflowsWhenRescaledIsAbsent) {
  const Key large{1, 160, {1 << 30, 0}, {}};
  state = advanced(std::nullopt, large, 0);
  EXPECT_TRUE(decode({2, 160, 1, 0xbf}));
  EXPECT_FALSE(decode({2, 159, 1, 0xbf}));
  const Key fine{1, 150, {7, 7}, {}};
  EXPECT_EQ(decode_key(layout, 1, state, encode_key(layout, state, fine, 0).value().payload).value(), fine);
}

TEST(HostileFloat, StepsAndNonFiniteValuesAreRejected) {
  const CoefficientLayout layout{CodecKind::kFloat64, 1, 1, {1}};
  const auto payload = [](std::uint8_t step, double value) {
    Bytes out;
    ByteWriter writer(out);
    writer.u8(0);
    writer.u8(step);
    writer.varint(8);
    writer.f64(value);
    return out;
  };
  EXPECT_EQ(decode_key(layout, 1, {}, payload(0, 2.5))->f[0], 2.5);
  EXPECT_FALSE(decode_key(layout, 1, {}, payload(1, 2.5)));
  EXPECT_FALSE(decode_key(layout, 1, {}, payload(0, std::numeric_limits<double>::infinity())));
  EXPECT_FALSE(decode_key(layout, 1, {}, payload(0, std::nan(""))));
}

TEST(HostileJoin, OlderBandsMustBeAmongTheNewers) {
  const CoefficientLayout layout{CodecKind::kQuantised, 2, 1, {1, 2}};
  EXPECT_TRUE(decode_join(layout, 1, Bytes{2, 160, 160, 1, 5, 2, 0x9f, 0x9f}));
  EXPECT_FALSE(decode_join(layout, 1, Bytes{2, 160, 160, 2, 5, 2, 0x9f, 0x9f}));
  EXPECT_FALSE(decode_join(
      layout, 1, Bytes{2, 160, 160, 1, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 1, 2, 0x9f, 0x9f}));
}

}  // namespace
}  // namespace eigencast
