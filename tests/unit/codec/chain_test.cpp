// SPDX-License-Identifier: MIT
#include "common/codec/chain.h"

#include <gtest/gtest.h>

#include <random>

#include "tests/unit/codec/motion_sample.h"

namespace eigencast {
namespace {

class EachCodec : public testing::TestWithParam<CodecKind> {};
INSTANTIATE_TEST_SUITE_P(Codecs, EachCodec,
                         testing::Values(CodecKind::kFloat64, CodecKind::kFloat32, CodecKind::kQuantised),
                         [](const auto& codec) { return std::string(name_of(codec.param)); });

/// The key with only the bands of `keep`.
Key cut(const CoefficientLayout& layout, Key key, BandMask keep) {
  for (std::size_t band = 0; band < layout.band_ends.size(); ++band) {
    if (keep.has(band)) continue;
    const auto [first, last] = layout.range(band);
    for (std::size_t i = first; i < last; ++i) {
      if (!key.q.empty()) key.q[i] = 0;
      if (!key.f.empty()) key.f[i] = 0;
    }
  }
  key.bands &= keep;
  return key;
}

/// What a receiver makes of the state as a join, whose envelope has the age.
Result<ChainState> joined(const CoefficientLayout& layout, BandMask bands, const ChainState& state) {
  auto made = decode_join(layout, bands, encode_join(layout, state).value());
  if (made) made->age_us = state.age_us;
  return made;
}

TEST_P(EachCodec, ReceiverHoldsTheSendersStateAcrossStepChanges) {
  const CoefficientLayout layout = layout_of(GetParam());
  const MotionSample motion(layout);
  ChainState sender = advanced(std::nullopt, motion.key(0, 150), 0);
  auto receiver = joined(layout, layout.all_bands(), sender);
  ASSERT_TRUE(receiver) << receiver.error().message;
  ASSERT_EQ(*receiver, sender);
  for (int frame = 1; frame < 60; ++frame) {
    const Key key = motion.key(frame, static_cast<std::uint8_t>(150 + frame / 7 * 3 % 11));
    const auto decoded =
        decode_key(layout, layout.all_bands(), *receiver, encode_key(layout, sender, key, 0).value().payload);
    ASSERT_TRUE(decoded) << decoded.error().message;
    ASSERT_EQ(*decoded, key);
    sender = advanced(sender, key, 33'333);
    receiver = advanced(*receiver, *decoded, 33'333);

    const auto joiner = joined(layout, layout.all_bands(), sender);
    ASSERT_TRUE(joiner) << joiner.error().message;
    ASSERT_EQ(*joiner, *receiver);
  }
}

TEST_P(EachCodec, ResidualsDecodeExactlyWithoutSpacing) {
  const CoefficientLayout layout = layout_of(GetParam());
  const MotionSample motion(layout);
  const ChainState state = motion.state(150);
  for (std::uint32_t at = 1; at < 15; ++at) {
    const Key base = interpolate_keys(layout, state.older, state.newer, at, 15).value();
    const Key pose = interpolate_keys(layout, state.newer, motion.key(2, 150), at, 15).value();
    const auto coded = encode_residual(layout, base, pose, 0).value();
    EXPECT_EQ(decode_residual(layout, coded.bands, base, coded.payload).value(), pose);
    EXPECT_TRUE(encode_residual(layout, base, base, 0)->bands.empty());
  }
  EXPECT_EQ(interpolate_keys(layout, state.older, state.newer, 7, 7).value(), state.newer) << "to the bit";
}

TEST_P(EachCodec, CuttingBandsEqualsDecodingOnlyThose) {
  const CoefficientLayout layout = layout_of(GetParam(), 120);
  const MotionSample motion(layout);
  const ChainState state = motion.state(150);
  const Key key = motion.key(2, 153);
  const std::uint8_t all = layout.all_bands().bits;
  const CodedKey coded = encode_key(layout, state, key, 3).value();
  const Bytes join = encode_join(layout, state).value();
  for (int mask = 1; mask <= all; ++mask) {
    const auto keep = static_cast<std::uint8_t>(mask);
    const ChainState cut_state{cut(layout, state.older, keep), cut(layout, state.newer, keep), 0};
    const auto short_join = cut_bands(layout, true, all, keep, join);
    ASSERT_TRUE(short_join);
    EXPECT_EQ(decode_join(layout, keep, *short_join).value(), cut_state);
    const auto short_key = cut_bands(layout, false, all, keep, coded.payload);
    ASSERT_TRUE(short_key);
    EXPECT_EQ(decode_key(layout, keep, cut_state, *short_key).value(), cut(layout, coded.key, keep));
    EXPECT_EQ(*short_key, encode_key(layout, cut_state, cut(layout, key, keep), 3).value().payload);
  }
  EXPECT_EQ(cut_bands(layout, false, all, 0, coded.payload).error().code, ErrorCode::kInvalidArgument);
}

TEST_P(EachCodec, NewBandIsCodedWithoutPrediction) {
  const CoefficientLayout layout = layout_of(GetParam());
  const MotionSample motion(layout);
  const ChainState full = motion.state(150);
  const ChainState narrow{cut(layout, full.older, 1), cut(layout, full.newer, 1), full.age_us};
  const Key key = motion.key(2, 150);
  const Bytes payload = encode_key(layout, narrow, key, 0).value().payload;
  EXPECT_EQ(decode_key(layout, key.bands, narrow, payload).value(), key);
  const ChainState grown = advanced(narrow, key, 33'333);
  EXPECT_EQ(joined(layout, key.bands, grown).value(), grown);
}

TEST(Chain, JoinOmitsBandsOfTheOlderKeyAlone) {
  const CoefficientLayout layout = layout_of(CodecKind::kQuantised);
  const ChainState full = MotionSample(layout).state(150);
  const ChainState shrunk{full.older, cut(layout, full.newer, 1), full.age_us};
  const ChainState expected{cut(layout, full.older, 1), shrunk.newer, full.age_us};
  EXPECT_EQ(joined(layout, 1, shrunk).value(), expected);
}

TEST(Chain, UnchangedPoseCostsThreeBytesPerBand) {
  const CoefficientLayout layout = layout_of(CodecKind::kQuantised, 200);
  const Key key = MotionSample(layout).key(3, 150);
  const CodedKey coded = encode_key(layout, advanced(std::nullopt, key, 0), key, 4).value();
  EXPECT_LE(coded.payload.size(), 1 + 3 * layout.band_ends.size());
  EXPECT_EQ(coded.key, key);
}

TEST(Chain, CoarseKeysStayWithinTheirErrorBounds) {
  for (const std::uint32_t channels : {1u, 3u, 4u}) {
    const CoefficientLayout layout = layout_of(CodecKind::kQuantised, 200, channels);
    const MotionSample motion(layout);
    for (const std::uint8_t half_spacing : {1, 4, 7, 63}) {
      ChainState sender = advanced(std::nullopt, motion.key(0, 150), 0);
      ChainState receiver = sender;
      double squares = 0, worst = 0;
      for (int frame = 1; frame < 40; ++frame) {
        const Key target = motion.key(frame, 150);
        const CodedKey coded = encode_key(layout, sender, target, half_spacing).value();
        EXPECT_EQ(half_spacing_of(coded.payload), half_spacing);
        const auto decoded = decode_key(layout, layout.all_bands(), receiver, coded.payload);
        ASSERT_TRUE(decoded) << decoded.error().message;
        ASSERT_EQ(*decoded, coded.key);
        for (std::size_t i = 0; i < layout.size(); ++i) {
          const double error = double{static_cast<double>(target.q[i])} - coded.key.q[i];
          squares += error * error;
          worst = std::max(worst, std::abs(error));
        }
        sender = advanced(sender, coded.key, 33'333);
        receiver = advanced(receiver, *decoded, 33'333);
      }
      const double rms = std::sqrt(squares / (39 * static_cast<double>(layout.size())));
      EXPECT_LE(rms, 0.66 * half_spacing) << int{half_spacing};
      EXPECT_LE(worst, 3 * half_spacing) << int{half_spacing};
    }
  }
}

TEST(Chain, ResidualsStayWithinHalfSpacing) {
  std::mt19937 random(3);
  for (const std::uint32_t channels : {1u, 3u, 4u}) {
    const CoefficientLayout layout = layout_of(CodecKind::kQuantised, 200, channels);
    const MotionSample motion(layout);
    for (const std::uint8_t half_spacing : {0, 1, 4, 15, 63}) {
      for (int frame = 1; frame < 40; ++frame) {
        const Key base = interpolate_keys(layout, motion.key(frame - 1, 150), motion.key(frame, 150), 1, 3).value();
        Key pose = base;
        for (std::int32_t& q : pose.q)
          q += static_cast<std::int32_t>(random() % (2u << random() % 13)) -
               static_cast<std::int32_t>(1u << random() % 12);
        const auto coded = encode_residual(layout, base, pose, half_spacing).value();
        EXPECT_EQ(half_spacing_of(coded.payload), half_spacing);
        const auto decoded = decode_residual(layout, coded.bands, base, coded.payload);
        ASSERT_TRUE(decoded) << decoded.error().message;
        for (std::size_t i = 0; i < layout.size(); ++i) ASSERT_LE(std::abs(decoded->q[i] - pose.q[i]), half_spacing);
      }
    }
  }
}

TEST(Chain, OnlyBandsBeyondHalfSpacingHaveResiduals) {
  const CoefficientLayout layout = layout_of(CodecKind::kQuantised);
  const MotionSample motion(layout);
  const Key base = motion.key(1, 150);
  Key pose = base;
  pose.q[layout.range(0).first] += 4;
  pose.q[layout.range(1).first] -= 5;
  const auto coded = encode_residual(layout, base, pose, 4).value();
  EXPECT_EQ(coded.bands, BandMask(0b10));
  EXPECT_EQ(decode_residual(layout, coded.bands, base, coded.payload)->bands, base.bands);
  // Bands that one of the two lacks stay as they are.
  const Key narrow = cut(layout, base, 1);
  EXPECT_TRUE(encode_residual(layout, narrow, pose, 4)->bands.empty());
  EXPECT_EQ(decode_residual(layout, coded.bands, narrow, coded.payload).error().code, ErrorCode::kCorrupt);
}

TEST(Chain, ResidualOfAnotherStepIsRefused) {
  const CoefficientLayout layout = layout_of(CodecKind::kQuantised);
  const MotionSample motion(layout);
  const Key base = motion.key(1, 150), other = motion.key(2, 147);
  EXPECT_EQ(encode_residual(layout, base, other, 4).error().code, ErrorCode::kInvalidArgument);
  const Bytes payload = encode_key(layout, {base, base, 0}, other, 4)->payload;
  EXPECT_EQ(decode_residual(layout, layout.all_bands(), base, payload).error().code, ErrorCode::kCorrupt);
}

TEST(Chain, CoarserSpacingsCostLess) {
  const CoefficientLayout layout = layout_of(CodecKind::kQuantised, 200);
  const MotionSample motion(layout);
  std::size_t before = SIZE_MAX;
  for (const std::uint8_t half_spacing : {0, 2, 4, 8, 16, 32, 63}) {
    const std::size_t bytes = encode_key(layout, motion.state(150), motion.key(2, 150), half_spacing)->payload.size();
    EXPECT_LT(bytes, before) << int{half_spacing};
    before = bytes;
  }
}

TEST(Chain, RandomAndExtremeKeysRoundTrip) {
  std::mt19937 random(7);
  for (const std::uint32_t rows : {1u, 2u, 15u, 64u}) {
    for (const std::uint32_t channels : {1u, 3u, 16u}) {
      const CoefficientLayout layout = layout_of(CodecKind::kQuantised, rows, channels);
      ChainState state;
      for (int frame = 0; frame < 40; ++frame) {
        Key key;
        key.bands = layout.all_bands();
        key.step = static_cast<std::uint8_t>(frame % 3 == 0 ? random() % 256 : 160);
        for (std::size_t i = 0; i < layout.size(); ++i) {
          const int bits = static_cast<int>(random() % 31);
          const auto value = static_cast<std::int32_t>(random() % ((std::uint32_t{1} << bits) + 1));
          key.q.push_back(random() % 2 == 0 ? value : -value);
        }
        key.q[random() % key.q.size()] = frame % 2 == 0 ? 1 << 30 : -(1 << 30);
        if (frame == 0) state = advanced(std::nullopt, key, 0);
        const auto half_spacing = static_cast<std::uint8_t>(1 + random() % 63);
        const CodedKey coarse = encode_key(layout, state, key, half_spacing).value();
        EXPECT_LE(coarse.payload.size(), 2 + 6 * layout.band_ends.size() + 12 * layout.size());
        const auto near = decode_key(layout, key.bands, state, coarse.payload);
        ASSERT_TRUE(near) << near.error().message;
        ASSERT_EQ(*near, coarse.key);
        Key base = state.newer;
        base.step = key.step;
        const auto residual = encode_residual(layout, base, key, half_spacing).value();
        EXPECT_LE(residual.payload.size(), 2 + 6 * layout.band_ends.size() + 12 * layout.size());
        const auto seen = decode_residual(layout, residual.bands, base, residual.payload);
        ASSERT_TRUE(seen || residual.bands.empty()) << seen.error().message;
        for (std::size_t i = 0; seen && i < key.q.size(); ++i) {
          ASSERT_LE(std::abs(std::int64_t{seen->q[i]} - key.q[i]), half_spacing);
        }
        const Bytes payload = encode_key(layout, state, key, 0).value().payload;
        EXPECT_LE(payload.size(), 2 + 5 * layout.band_ends.size() + 7 * layout.size());
        const auto decoded = decode_key(layout, key.bands, state, payload);
        ASSERT_TRUE(decoded) << decoded.error().message;
        ASSERT_EQ(*decoded, key);
        state = advanced(state, key, 1);
        ASSERT_EQ(joined(layout, key.bands, state).value(), state);
      }
    }
  }
}

TEST(Chain, EncoderRefusesWhatNoDecoderAccepts) {
  const CoefficientLayout layout = layout_of(CodecKind::kQuantised);
  const MotionSample motion(layout);
  const ChainState state = motion.state(150);
  Key key = motion.key(2, 150);
  key.q[5] = (1 << 30) + 1;
  EXPECT_EQ(encode_key(layout, state, key, 0).error().code, ErrorCode::kTooLarge);
  EXPECT_EQ(encode_residual(layout, state.newer, key, 4).error().code, ErrorCode::kTooLarge);
  key.q.pop_back();
  EXPECT_EQ(encode_key(layout, state, key, 0).error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(encode_residual(layout, state.newer, key, 4).error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(encode_residual(layout, state.newer, motion.key(2, 150), 64).error().code, ErrorCode::kInvalidArgument);

  const CoefficientLayout narrow = layout_of(CodecKind::kFloat32);
  Key wide = MotionSample(narrow).key(0, 0);
  wide.f[0] = 1e300;
  EXPECT_EQ(encode_key(narrow, MotionSample(narrow).state(0), wide, 0).error().code, ErrorCode::kTooLarge);
}

}  // namespace
}  // namespace eigencast
