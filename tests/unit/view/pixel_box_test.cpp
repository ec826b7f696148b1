// SPDX-License-Identifier: MIT
#include "view/camera.h"

#include <gtest/gtest.h>

#include <vector>

namespace eigencast {
namespace {

TEST(PixelBox, WhatIsAroundCoversEachOtherPixelOnce) {
  constexpr int kWidth = 9, kHeight = 7;
  for (const PixelBox& box : {PixelBox{2, 1, 4, 3}, PixelBox{0, 0, 9, 7}, PixelBox{}, PixelBox{5, 0, 4, 7}}) {
    std::vector<int> times(kWidth * kHeight);
    const auto count = [&](const PixelBox& part) {
      for (int y = part.y; y < part.y + part.height; ++y) {
        for (int x = part.x; x < part.x + part.width; ++x) ++times[static_cast<std::size_t>(y * kWidth + x)];
      }
    };
    count(box);
    for (const PixelBox& part : box.around(kWidth, kHeight)) count(part);
    EXPECT_EQ(times, std::vector<int>(kWidth * kHeight, 1)) << box.x << " " << box.width;
  }
}

TEST(PixelBox, HoldsTheProjectedPointsWithinThePicture) {
  const std::vector<glm::vec3> points{{-0.5F, -0.5F, 0}, {0.25F, 0, 0}};
  EXPECT_EQ(pixels_of(points, glm::mat4(1), 80, 40, 0), (PixelBox{20, 10, 30, 10}));
  EXPECT_EQ(pixels_of(points, glm::mat4(1), 80, 40, 100), (PixelBox{0, 0, 80, 40}));
  const std::vector<glm::vec3> beside{{2, 2, 0}, {3, 3, 0}};
  EXPECT_TRUE(pixels_of(beside, glm::mat4(1), 80, 40, 1).empty());
  glm::mat4 behind(1);
  behind[3][3] = -1;
  EXPECT_EQ(pixels_of(points, behind, 80, 40, 0), (PixelBox{0, 0, 80, 40})) << "nothing is known behind the eye";
}

TEST(PixelBox, JoinsBoxes) {
  EXPECT_EQ((PixelBox{1, 2, 3, 4}.with({})), (PixelBox{1, 2, 3, 4}));
  EXPECT_EQ((PixelBox{}.with({1, 2, 3, 4})), (PixelBox{1, 2, 3, 4}));
  EXPECT_EQ((PixelBox{1, 2, 3, 4}.with({0, 5, 2, 3})), (PixelBox{0, 2, 4, 6}));
}

}  // namespace
}  // namespace eigencast
