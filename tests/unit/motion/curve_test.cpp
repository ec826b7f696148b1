// SPDX-License-Identifier: MIT
#include "common/motion/curve.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>

#include "tests/unit/motion/support.h"

namespace eigencast {
namespace {

double parabola(TimeUs t_us) {
  const double t = static_cast<double>(t_us) * 1e-6;
  return 3 - 2 * t + 50 * t * t;
}
double cubic(TimeUs t_us) {
  const double t = static_cast<double>(t_us) * 1e-6;
  return 3 - 2 * t + 50 * t * t - 400 * t * t * t;
}
TEST(Curve, CatmullRomMatchesItsMatrixAtEvenKeys) {
  for (const double u : {0.0, 0.25, 0.5, 0.75, 1.0}) {
    const auto t = static_cast<TimeUs>(u * 40'000);
    const CurveWeights w = catmull_rom_weights(-40'000, 0, 40'000, 80'000, t);
    EXPECT_NEAR(w.before, 0.5 * (-u + 2 * u * u - u * u * u), 1e-15);
    EXPECT_NEAR(w.from, 0.5 * (2 - 5 * u * u + 3 * u * u * u), 1e-15);
    EXPECT_NEAR(w.to, 0.5 * (u + 4 * u * u - 3 * u * u * u), 1e-15);
    EXPECT_NEAR(w.after, 0.5 * (-u * u + u * u * u), 1e-15);
  }
}

TEST(Curve, CatmullRomReproducesParabolas) {
  const std::array<TimeUs, 4> t{0, 17 * kMs, 60 * kMs, 71 * kMs};
  for (TimeUs at = t[1]; at <= t[2]; at += kMs) {
    for (const bool with_before : {false, true}) {
      for (const bool with_after : {false, true}) {
        if (!with_before && !with_after) continue;
        const CurveWeights w = catmull_rom_weights(with_before ? std::optional(t[0]) : std::nullopt, t[1], t[2],
                                                   with_after ? std::optional(t[3]) : std::nullopt, at);
        const double value =
            w.before * parabola(t[0]) + w.from * parabola(t[1]) + w.to * parabola(t[2]) + w.after * parabola(t[3]);
        EXPECT_NEAR(value, parabola(at), 1e-12) << at << with_before << with_after;
        EXPECT_NEAR(w.before + w.from + w.to + w.after, 1, 1e-14);
      }
    }
  }
}

TEST(Curve, CatmullRomWithoutNeighboursIsLinear) {
  const CurveWeights w = catmull_rom_weights({}, 0, 3000, {}, 1000);
  EXPECT_DOUBLE_EQ(w.from, 2.0 / 3);
  EXPECT_DOUBLE_EQ(w.to, 1.0 / 3);
  EXPECT_EQ(w.before, 0);
  EXPECT_EQ(w.after, 0);
  EXPECT_EQ(catmull_rom_weights({}, 100, 400, {}, 0).from, 1);
  EXPECT_EQ(catmull_rom_weights({}, 100, 400, {}, 500).to, 1);
}

TEST(Curve, CatmullRomSlopeIsContinuousAcrossKeys) {
  const std::array<TimeUs, 5> t{0, 30 * kMs, 70 * kMs, 90 * kMs, 150 * kMs};
  const auto value = [&](std::size_t i, TimeUs at) {
    const CurveWeights w = catmull_rom_weights(t[i - 1], t[i], t[i + 1], t[i + 2], at);
    return w.before * cubic(t[i - 1]) + w.from * cubic(t[i]) + w.to * cubic(t[i + 1]) + w.after * cubic(t[i + 2]);
  };
  const double before = value(1, t[2]) - value(1, t[2] - 10), after = value(2, t[2] + 10) - value(2, t[2]);
  EXPECT_NEAR(before, after, 1e-3 * std::abs(before));
}

TEST(Curve, DampedStepsFormAGeometricSum) {
  for (const double h : {0.0, 0.5, 1.0, 3.0}) EXPECT_EQ(damped_steps(h, 1), h);
  EXPECT_DOUBLE_EQ(damped_steps(1, 0.85), 0.85);
  EXPECT_DOUBLE_EQ(damped_steps(3, 0.85), 0.85 + 0.85 * 0.85 + 0.85 * 0.85 * 0.85);
  EXPECT_DOUBLE_EQ(damped_steps(0.5, 0.85), 0.425);
  EXPECT_LT(damped_steps(1000, 0.85), 0.85 / 0.15 + 1e-9);
}

}  // namespace
}  // namespace eigencast
