// SPDX-License-Identifier: MIT
#include "common/codec/key.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "common/codec/fixed.h"
#include "tests/unit/codec/motion_sample.h"

namespace eigencast {
namespace {

constexpr std::int32_t kMaxQ = 1 << 30;

Key key_of(std::vector<std::int32_t> q, std::uint8_t step) {
  return {1, step, std::move(q), {}};
}
CoefficientLayout row_of(std::size_t values) {
  return {CodecKind::kQuantised, static_cast<std::uint32_t>(values), 1, {static_cast<std::uint32_t>(values)}};
}

/// The start of the way to a key at that step.
Result<Key> rescale(const Key& key, std::uint8_t step) {
  const Key at_step = key_of(std::vector<std::int32_t>(key.q.size()), step);
  return interpolate_keys(row_of(key.q.size()), key_of(key.q, key.step), at_step, 0, 1);
}

TEST(StepTable, IsGeometricAndInvertible) {
  EXPECT_EQ(step_size(160), 1.0);
  EXPECT_EQ(step_size(164), 2.0);
  EXPECT_EQ(step_size(0), std::ldexp(1.0, -40));
  for (int i = 0; i < 256; ++i) {
    const auto index = static_cast<std::uint8_t>(i);
    EXPECT_NEAR(step_size(index) / std::exp2((i - 160) / 4.0), 1.0, 1e-15);
    EXPECT_EQ(step_index_below(step_size(index)), index);
    EXPECT_EQ(step_index_below(step_size(index) * 1.18), index);
    if (i > 0) {
      EXPECT_EQ(step_index_below(std::nextafter(step_size(index), 0)), index - 1);
    }
  }
  EXPECT_EQ(step_index_below(0), 0);
  EXPECT_EQ(step_index_below(1e300), 255);
  EXPECT_EQ(step_index_below(std::nan("")), 0);
}

TEST(QuantiserForError, BoundsTheErrorThatParsevalPredicts) {
  // rms^2 = sum of squared coefficient errors / area. Unpredictable values are the worst case: no residual is
  // near 0, where the error would be that of the prediction.
  const double eps = 1e-3;
  const double area = 7;
  const CoefficientLayout layout = layout_of(CodecKind::kQuantised, 200);
  std::mt19937 random(1);
  std::uniform_real_distribution<double> uniform(-100, 100);
  double squares = 0;
  const Quantiser quantiser = quantiser_for_error(eps, area, 200);
  ChainState state =
      advanced(std::nullopt, key_from_coefficients(layout, std::vector<double>(600), quantiser.step).value(), 0);
  for (int frame = 0; frame < 50; ++frame) {
    std::vector<double> C(layout.size());
    for (double& c : C) c = uniform(random);
    const Key key = key_from_coefficients(layout, C, quantiser.step).value();
    state = advanced(state, encode_key(layout, state, key, quantiser.half_spacing).value().key, 1);
    squares += std::pow(surface_distance(C, coefficients_from_key(layout, state.newer), area), 2);
  }
  const double rms = std::sqrt(squares / 50);
  EXPECT_LE(rms, eps * 1.01);
  EXPECT_GE(rms, eps * 0.8);
}

TEST(KeyFromCoefficients, RoundsHalfAwayAndRefusesOverflow) {
  const CoefficientLayout layout = row_of(4);
  const std::vector<double> halves = {0.5, -0.5, 1.4999, -2.5};
  EXPECT_EQ(key_from_coefficients(layout, halves, 160)->q, (std::vector<std::int32_t>{1, -1, 1, -3}));
  const std::vector<double> edge = {1073741824.0, -1073741824.0, 0, 0};
  EXPECT_EQ(key_from_coefficients(layout, edge, 160)->q[0], kMaxQ);
  for (const double bad : {1073741825.0, 1e300}) {
    EXPECT_EQ(key_from_coefficients(layout, std::vector<double>{0, bad, 0, 0}, 160).error().code, ErrorCode::kTooLarge);
  }
  for (const double bad : {std::nan(""), std::numeric_limits<double>::infinity()}) {
    EXPECT_EQ(key_from_coefficients(layout, std::vector<double>{0, bad, 0, 0}, 160).error().code,
              ErrorCode::kInvalidArgument);
  }
  EXPECT_EQ(key_from_coefficients(layout, std::vector<double>{0}, 160).error().code, ErrorCode::kInvalidArgument);
}

TEST(Rescale, RoundsTheExactRatioToNearest) {
  std::mt19937 random(3);
  for (int trial = 0; trial < 20000; ++trial) {
    const auto from = static_cast<std::uint8_t>(random() % 256);
    const auto to = static_cast<std::uint8_t>(random() % 256);
    const auto q = static_cast<std::int32_t>(random() % (std::uint32_t{1} << (random() % 31)));
    const double exact = q * std::exp2((int{from} - int{to}) / 4.0);
    const auto result = rescale(key_of({q, -q}, from), to);
    if (exact > 1.0001 * kMaxQ) {
      EXPECT_EQ(result.error().code, ErrorCode::kTooLarge);
    } else if (exact < 0.9999 * kMaxQ) {
      ASSERT_TRUE(result);
      // The 31-bit multiplier is exact to 2^-30 of the value.
      EXPECT_NEAR(result->q[0], exact, 0.5 + exact * 0x1p-29);
      EXPECT_EQ(result->q[1], -result->q[0]);
      EXPECT_EQ(result->step, to);
    }
  }
}

TEST(Rescale, IsExactForOctavesAndEqualSteps) {
  EXPECT_EQ(rescale(key_of({kMaxQ, -kMaxQ, 0, 1}, 9), 9)->q, (std::vector<std::int32_t>{kMaxQ, -kMaxQ, 0, 1}));
  EXPECT_EQ(rescale(key_of({5, -7, 1 << 22}, 180), 148)->q, (std::vector<std::int32_t>{1280, -1792, kMaxQ}));
  EXPECT_EQ(rescale(key_of({2, 3, -3, 1}, 160), 164)->q, (std::vector<std::int32_t>{1, 2, -2, 1}))
      << "halves round away from zero";
  EXPECT_EQ(rescale(key_of({kMaxQ, -1}, 0), 255)->q, (std::vector<std::int32_t>{0, 0}));
  EXPECT_EQ(rescale(key_of({0}, 255), 0)->q[0], 0);
  EXPECT_EQ(rescale(key_of({1}, 255), 0).error().code, ErrorCode::kTooLarge);
  EXPECT_EQ(rescale(key_of({1}, 120), 0)->q[0], kMaxQ);
  EXPECT_EQ(rescale(key_of({kMaxQ}, 160), 159).error().code, ErrorCode::kTooLarge);
}

TEST(Interpolate, EqualsExactRationalRounding) {
  std::mt19937 random(5);
  const CoefficientLayout layout = row_of(1);
  for (int trial = 0; trial < 20000; ++trial) {
    const auto value = [&] { return static_cast<std::int32_t>(random() % (2 * std::uint32_t{kMaxQ} + 1)) - kMaxQ; };
    const std::int32_t a = trial % 2 == 0 ? value() : static_cast<std::int32_t>(random() % 41) - 20;
    const std::int32_t b = trial % 2 == 0 ? value() : static_cast<std::int32_t>(random() % 41) - 20;
    const std::uint32_t of = 1 + static_cast<std::uint32_t>(random() % (trial % 3 == 0 ? 65535 : 15));
    const std::uint32_t at = static_cast<std::uint32_t>(random() % (of + 1));
    const std::int64_t q = interpolate_keys(layout, key_of({a}, 160), key_of({b}, 160), at, of)->q[0];
    const std::int64_t difference = std::int64_t{b} - a;
    // 2 of |(q - a) - difference at / of| <= of, and a tie goes away from zero.
    const std::int64_t gap = 2 * ((q - a) * of - difference * at);
    ASSERT_LE(std::abs(gap), of);
    if (std::abs(gap) == of) {
      EXPECT_EQ(gap > 0, difference > 0);
    }
  }
}

TEST(Interpolate, EndpointsAreTheKeysAtTheLaterStep) {
  const CoefficientLayout layout = layout_of(CodecKind::kQuantised);
  const MotionSample motion(layout);
  const Key a = motion.key(0, 150);
  const Key b = motion.key(1, 147);
  EXPECT_EQ(interpolate_keys(layout, a, b, 3, 3).value(), b);
  const auto start = interpolate_keys(layout, a, b, 0, 3).value();
  EXPECT_EQ(start.step, b.step);
  EXPECT_EQ(start.bands, a.bands);
  const fixed::Rescale rule(a.step, b.step);
  for (std::size_t i = 0; i < a.q.size(); ++i) ASSERT_EQ(start.q[i], rule(a.q[i])) << i;
  EXPECT_EQ(interpolate_keys(layout, a, b, 4, 3).error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(interpolate_keys(layout, a, b, 0, 0).error().code, ErrorCode::kInvalidArgument);
}

TEST(Interpolate, UsesBandsOfBothKeys) {
  const CoefficientLayout layout{CodecKind::kFloat64, 3, 1, {1, 2, 3}};
  const Key a{0b011, 0, {}, {1, 2, 0}};
  const Key b{0b110, 0, {}, {0, 4, 8}};
  EXPECT_EQ(interpolate_keys(layout, a, b, 1, 2).value(), (Key{0b010, 0, {}, {0, 3, 0}}));
}

TEST(Layout, DefaultBandsEndAtTheRows) {
  EXPECT_EQ(default_band_ends(200), (std::vector<std::uint32_t>{14, 54, 104, 200}));
  EXPECT_EQ(default_band_ends(54), (std::vector<std::uint32_t>{14, 54}));
  EXPECT_EQ(default_band_ends(1), (std::vector<std::uint32_t>{1}));
  EXPECT_EQ(layout_of(CodecKind::kQuantised, 200).range(1), (std::pair<std::size_t, std::size_t>{42, 162}));
}

TEST(CodecNames, RoundTrip) {
  for (const CodecKind kind : {CodecKind::kFloat64, CodecKind::kFloat32, CodecKind::kQuantised}) {
    EXPECT_EQ(codec_from_name(name_of(kind)).value(), kind);
  }
  EXPECT_EQ(codec_from_name("float16").error().code, ErrorCode::kUnsupported);
}

}  // namespace
}  // namespace eigencast
