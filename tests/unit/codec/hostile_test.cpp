// SPDX-License-Identifier: MIT
//
// Hostile bytes: a decoder accepts no truncation, no extra byte and no malformed head, and no bit flip crashes it.
#include <gtest/gtest.h>

#include <limits>
#include <memory>

#include "common/codec/coarse_model.h"
#include "common/codec/range_coder.h"
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
      // Other spacings, and the step of the newer key, which is that of the sample.
      if (!is_join && codec % 4 >= 2 && GetParam() == CodecKind::kQuantised) continue;
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

TEST_F(OneBand, MalformedExactRunsAreRejected) {
  // codec 2, step 160, one section: head, bits.
  EXPECT_EQ(decode({2, 160, 1, 0x9f})->q, (std::vector<std::int32_t>{0, 0})) << "all zero";
  EXPECT_EQ(decode({2, 160, 2, 0x80, 0b1101'0000})->q, (std::vector<std::int32_t>{1, -1}))
      << "k = 0: z = 2, then z = 1";
  EXPECT_FALSE(decode({2, 160, 2, 0x80, 0b1101'0001})) << "padding";
  EXPECT_FALSE(decode({2, 160, 3, 0x80, 0b1101'0000, 0})) << "a whole byte of padding";
  EXPECT_FALSE(decode({2, 160, 2, 0x9f, 0})) << "all zero, then a byte";
  EXPECT_FALSE(decode({2, 160, 1, 0xdf})) << "a reserved bit";
  EXPECT_FALSE(decode({2, 160, 1, 0x1f})) << "a bit that must be set";
  EXPECT_FALSE(decode({2, 160, 0})) << "no head";
  EXPECT_FALSE(decode({2, 160, 1, 0xbf})) << "differences from a key that is not there";
  EXPECT_FALSE(decode({2 | 4 << 2, 160, 1, 0x44})) << "a coarse run without a key before it";
  EXPECT_EQ(decode({2 | 4 << 2, 160, 2, 0xff, 0x9f})->q, (std::vector<std::int32_t>{0, 0})) << "exact all the same";
  EXPECT_FALSE(decode({2, 160, 2, 0xff, 0x9f})) << "exact, where nothing else can be";
  EXPECT_FALSE(decode({2 | 4 << 2, 160, 1, 0xff})) << "no head after the mark";
  EXPECT_FALSE(decode({2, 160, 0x81, 0x00, 0x9f})) << "a length with a superfluous byte";
  EXPECT_FALSE(decode({2, 160, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x01, 0x9f}))
      << "a length of 2^64 - 1";
}

/// A section of two values that were at 0 and are at +-16, coded with m = 4: both levels are 0, so that they go on as
/// the weights say.
Bytes carried_on(unsigned speed, unsigned restoring, int scale = 0) {
  const std::vector<std::uint32_t> speeds = {16, 16};
  const unsigned expected = band::scale_code_of(32, 2, 4);
  Bytes out;
  band::RangeEncoder coder(out);
  coder.put(scale != 0, band::kScaleDiffers);
  if (scale != 0) {
    coder.put_even(scale < 0);
    for (int off = 1; off <= std::abs(scale); ++off) coder.put(off < std::abs(scale), band::kScaleFurther);
  }
  for (unsigned bit = 4; bit-- > 0;) coder.put_even((speed >> bit & 1) != 0);
  coder.put_even(restoring != 12);
  for (unsigned bit = 4; restoring != 12 && bit-- > 0;) coder.put_even((restoring >> bit & 1) != 0);
  const int code = static_cast<int>(expected) + scale;
  if (code >= 0 && code <= 30) {
    band::ContextModel contexts(speeds, {4, 1}, static_cast<unsigned>(code));
    for (int value = 0; value < 2; ++value) {
      coder.put(false, band::kMore[band::LevelOdds(0, contexts.next()).beyond_0]);
      contexts.add(0);
    }
  }
  coder.finish();
  return out;
}

TEST_F(OneBand, MalformedCoarseRunsAreRejected) {
  state = {Key{1, 160, {0, 0}, {}}, Key{1, 160, {16, -16}, {}}, 1};
  const auto payload = [](Bytes run, std::uint8_t codec = 2 | 4 << 2) {
    run.insert(run.begin(), {codec, 160, static_cast<std::uint8_t>(run.size())});
    return run;
  };
  EXPECT_EQ(decode(payload(carried_on(4, 12)))->q, (std::vector<std::int32_t>{16, -16})) << "held";
  EXPECT_EQ(decode(payload(carried_on(12, 12)))->q, (std::vector<std::int32_t>{32, -32})) << "going on";
  EXPECT_EQ(decode(payload(carried_on(4, 4)))->q, (std::vector<std::int32_t>{8, -8})) << "drawn back";
  EXPECT_EQ(decode(payload(carried_on(4, 12, 3)))->q, (std::vector<std::int32_t>{16, -16})) << "another scale";
  EXPECT_FALSE(decode(payload(carried_on(4, 12, 31)))) << "a scale beyond the last";
  EXPECT_FALSE(decode(payload(carried_on(4, 12, -31)))) << "a scale before the first";
  EXPECT_FALSE(decode(payload(carried_on(4, 12), 2))) << "no spacing";
  const Bytes held = carried_on(4, 12);
  Bytes longer = held;
  longer.push_back(0);
  EXPECT_FALSE(decode(payload(longer))) << "a 0 at the end is left out";
  longer.back() = 1;
  longer.insert(longer.end(), 5, 1);
  EXPECT_FALSE(decode(payload(longer))) << "bytes that no value needs";
  EXPECT_FALSE(decode(payload({}))) << "levels without end";
}

TEST_F(OneBand, StepDefaultsToThatOfTheNewerKey) {
  state = advanced(std::nullopt, Key{1, 77, {10, -10}, {}}, 0);
  EXPECT_EQ(decode({3, 2, 0xa2, 0xab}).value(), (Key{1, 77, {13, -14}, {}}));
  EXPECT_EQ(decode({2, 77, 2, 0xa2, 0xab}).value(), (Key{1, 77, {13, -14}, {}}));
  EXPECT_FALSE(decode_join(layout, 1, Bytes{3, 160, 0, 1, 0x9f})) << "a join has none before it";
}

TEST_F(OneBand, DecodesTheProtocolDocumentsExample) {
  state = advanced(std::nullopt, Key{1, 160, {10, -10}, {}}, 0);
  const Bytes payload{0x03, 0x02, 0xa2, 0xab};
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

TEST_F(OneBand, ReferenceThatOverflowsOnRescaleIsAbsent) {
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
  EXPECT_TRUE(decode_join(layout, 1, Bytes{2, 160, 160, 1, 2, 0x9f, 0x9f}));
  EXPECT_FALSE(decode_join(layout, 1, Bytes{2, 160, 160, 2, 2, 0x9f, 0x9f}));
}

}  // namespace
}  // namespace eigencast
