// SPDX-License-Identifier: MIT
#include "sender/line_chart.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <random>

namespace eigencast {
namespace {

TEST(LineChart, MarksAreRoundWithinAndAFew) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> exponent(-8, 6);
  for (int i = 0; i < 300; ++i) {
    const double a = std::pow(10, exponent(random)), b = std::pow(10, exponent(random));
    const double low = std::min(a, b), high = std::max(a, b) * 1.01;
    for (const bool logarithmic : {false, true}) {
      const std::vector<double> marks = axis_marks(low, high, logarithmic);
      EXPECT_GE(marks.size(), 2u) << low << " " << high;
      EXPECT_LE(marks.size(), 15u) << low << " " << high;
      EXPECT_TRUE(std::is_sorted(marks.begin(), marks.end()));
      for (const double mark : marks) {
        EXPECT_GE(mark, low);
        EXPECT_LE(mark, high);
      }
    }
  }
}

std::size_t pixels_of(const Picture& picture, const std::array<int, 3>& colour) {
  std::size_t count = 0;
  for (std::size_t i = 0; i + 3 <= picture.rgb.size(); i += 3)
    count += picture.rgb[i] == colour[0] && picture.rgb[i + 1] == colour[1] && picture.rgb[i + 2] == colour[2];
  return count;
}

TEST(LineChart, ALineIsAsLongAsItsAxes) {
  const LineChart chart{"title", "x", "y", false, false, {{"", {{0, 1}, {1, 1}}}}};
  const Picture picture = picture_of(chart);
  EXPECT_EQ(picture.width, 1200);
  const std::size_t blue = pixels_of(picture, {0, 114, 178});
  EXPECT_GT(blue, 900u);  // Nearly the width, twice as thick, and its dots.
  EXPECT_LT(blue, 2600u);
}

TEST(LineChart, WhatCannotBeDrawnIsLeftOut) {
  const LineChart none{"", "", "", true, true, {{"", {{0, 1}, {-1, 1}, {1, std::nan("")}, {1, HUGE_VAL}}}}};
  EXPECT_EQ(pixels_of(picture_of(none), {0, 114, 178}), 0u);
  const LineChart one{"", "", "", true, true, {{"", {{3, 3}, {-1, 1}}}}};
  EXPECT_GT(pixels_of(picture_of(one), {0, 114, 178}), 10u);
}

}  // namespace
}  // namespace eigencast
