// SPDX-License-Identifier: MIT
#include "common/codec/key.h"

#include <gtest/gtest.h>

#include <cmath>

namespace eigencast {
namespace {

const CoefficientLayout kLine{CodecKind::kQuantised, 1, 2, {1}};  // A value and its velocity.
const CoefficientLayout kDoubles{CodecKind::kFloat64, 1, 2, {1}};
const CoefficientLayout kTwoBands{CodecKind::kQuantised, 2, 1, {1, 2}};

Key line_key(std::vector<std::int32_t> q, std::uint8_t step = 160, std::uint8_t bands = 1) {
  return {bands, step, std::move(q), {}};
}
Key key_of_doubles(std::vector<double> f) {
  return {1, 0, {}, std::move(f)};
}

TEST(HermiteKeys, IsExactOnCubics) {
  // x = 1000 - 300 t + 200 t^2 + 700 t^3 over one second; velocities per second.
  const auto x = [](double t) { return 1000 - 300 * t + 200 * t * t + 700 * t * t * t; };
  const auto v = [](double t) { return -300 + 400 * t + 2100 * t * t; };
  for (const std::uint32_t of : {2U, 3U, 15U}) {
    for (std::uint32_t at = 1; at <= of; ++at) {
      const double t = static_cast<double>(at) / of;
      const Key pose = hermite_keys(kDoubles, {1, 1'000'000}, key_of_doubles({x(0), v(0)}),
                                    key_of_doubles({x(1), v(1)}), 1'000'000, at, of)
                           .value();
      EXPECT_NEAR(pose.f[0], x(t), 1e-9);
      EXPECT_NEAR(pose.f[1], v(0) + t * (v(1) - v(0)), 1e-9);
      // The same in integers, at steps that differ between the keys by a factor of 4.
      const Key coarse = line_key({250, -75}, 168), fine = line_key({1600, 2200});
      const Key q = hermite_keys(kLine, {1, 1'000'000}, coarse, fine, 1'000'000, at, of).value();
      EXPECT_NEAR(q.q[0], x(t), 1.0);
    }
  }
}

TEST(HermiteKeys, FollowsTheProtocolsIntegerRule) {
  // D = 6, at/of = 1/2: share of the movement 1/2; slopes 20 * 1 - 4 * 1 of 8ths, 50 ms in units of 10 ms.
  const Key pose = hermite_keys(kLine, {1, 10'000}, line_key({10, 20}), line_key({16, 4}), 50'000, 1, 2).value();
  // (6 * 4 + round((20 - 4) * 5)) / 8 = 104 / 8 = 13
  EXPECT_EQ(pose.q[0], 10 + 13);
  EXPECT_EQ(pose.q[1], 12) << "velocities themselves go straight";
}

TEST(HermiteKeys, IsLinearWithoutVelocitiesOrOverLongSpans) {
  const Key a = line_key({0, 50}), b = line_key({300, 50});
  const Key linear = interpolate_keys(kLine, a, b, 1, 3).value();
  EXPECT_EQ(hermite_keys(kLine, {}, a, b, 50'000, 1, 3).value(), linear);
  EXPECT_EQ(hermite_keys(kLine, {1, 1000}, a, b, kLongestHermiteUs + 1, 1, 3).value(), linear);
  EXPECT_EQ(hermite_keys(kLine, {1, 1000}, a, b, 0, 1, 3).value(), linear);
}

TEST(HermiteKeys, RefusesOverflow) {
  const std::int32_t most = 1 << 30;
  const auto pose = hermite_keys(kLine, {1, 1}, line_key({most, most}), line_key({most, -most}), 1'000'000, 7, 15);
  EXPECT_EQ(pose.error().code, ErrorCode::kTooLarge);
  const auto past = hermite_keys(kLine, {1, 1000}, line_key({most, 1000}), line_key({most, -1000}), 1'000'000, 7, 15);
  EXPECT_EQ(past.error().code, ErrorCode::kTooLarge);
}

TEST(EstimateKeys, IsEquation9) {
  for (std::uint32_t at = 1; at <= 15; ++at) {
    for (const std::uint32_t of : {1U, 3U, 15U}) {
      const Key pose =
          estimate_keys(kTwoBands, line_key({10, 0}, 160, 3), line_key({-20, 7}, 160, 3), false, at, of).value();
      EXPECT_EQ(pose.q[0], std::lround(-20 - 30.0 * at / of - (30 * at % of * 2 == of ? 0.01 : 0)));
    }
  }
}

TEST(EstimateKeys, DampedMovesLessWithEachInterval) {
  const Key older = line_key({0, 0}), newer = line_key({1 << 20, 0});
  const double rho = 27.0 / 32;
  const auto steps = [&](std::uint32_t at, std::uint32_t of) {
    return estimate_keys(kLine, older, newer, true, at, of)->q[0] / double{1 << 20} - 1;
  };
  EXPECT_NEAR(steps(1, 1), rho, 2e-5);
  EXPECT_NEAR(steps(1, 2), rho / 2, 2e-5);
  EXPECT_NEAR(steps(3, 1), rho + rho * rho + rho * rho * rho, 1e-4);
  EXPECT_NEAR(steps(7, 3), rho + rho * rho + rho * rho * rho / 3, 1e-4);
}

TEST(EstimateKeys, HoldsBandsOfTheNewerKeyAlone) {
  const Key pose = estimate_keys(kTwoBands, line_key({1, 0}, 160, 1), line_key({2, 9}, 160, 3), false, 1, 1).value();
  EXPECT_EQ(pose, line_key({3, 9}, 160, 3));
  EXPECT_EQ(estimate_keys(kTwoBands, line_key({-(1 << 30), 0}), line_key({1 << 30, 0}), false, 1, 1).error().code,
            ErrorCode::kTooLarge);
}

TEST(BlendKeys, SumsAtOneStepAndRoundsOnce) {
  const Key a = line_key({3, 0}, 164), b = line_key({5, 0}, 160);  // a is twice as coarse: 6
  const Key* keys[] = {&a, &b};
  const double weights[] = {-0.25, 1.25};
  EXPECT_EQ(blend_keys(kLine, keys, weights, 1)->q[0], 5);  // -1.5 + 6.25 = 4.75
  EXPECT_EQ(blend_keys(kLine, keys, weights, 0)->q[0], 2);  // 2.375
  const double huge[] = {1e9, 1e9};
  EXPECT_EQ(blend_keys(kLine, keys, huge, 1).error().code, ErrorCode::kTooLarge);
}

TEST(BlendKeys, HasTheBandsOfAllItsKeys) {
  const Key a = line_key({4, 4}, 160, 3), b = line_key({8, 0}, 160, 1);
  const Key* keys[] = {&a, &b};
  const double weights[] = {0.5, 0.5};
  EXPECT_EQ(blend_keys(kTwoBands, keys, weights, 0).value(), line_key({6, 0}, 160, 1));
}

}  // namespace
}  // namespace eigencast
