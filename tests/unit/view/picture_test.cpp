// SPDX-License-Identifier: MIT
#include "view/picture.h"

#include <gtest/gtest.h>

#include <fstream>

#include "tests/support/process.h"
#include "tests/unit/view/png.h"

namespace eigencast {
namespace {

TEST(Pictures, RoundTripThroughPng) {
  const testing::TemporaryFolder folder;
  Picture picture{5, 3, {}};
  for (int i = 0; i < 45; ++i) picture.rgb.push_back(static_cast<std::uint8_t>(i * 37));
  ASSERT_TRUE(write_png(folder.file("a.png"), picture));
  const auto back = testing::read_png(folder.file("a.png"));
  ASSERT_TRUE(back) << back.error().message;
  EXPECT_EQ(back->width, 5);
  EXPECT_EQ(back->height, 3);
  EXPECT_EQ(back->rgb, picture.rgb);
}

TEST(Pictures, ImpossibleOnesAreErrors) {
  const testing::TemporaryFolder folder;
  EXPECT_EQ(write_png(folder.file("a.png"), Picture{5, 3, {1, 2}}).error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(write_png(folder.file("a.png"), Picture{1, 1, {1, 2, 3}, {1, 2}}).error().code,
            ErrorCode::kInvalidArgument);
  EXPECT_EQ(write_png(folder.file("none/a.png"), Picture{1, 1, {1, 2, 3}}).error().code, ErrorCode::kIo);
  std::ofstream(folder.file("bad.png")) << "not a picture";
  EXPECT_EQ(testing::read_png(folder.file("bad.png")).error().code, ErrorCode::kCorrupt);
}

}  // namespace
}  // namespace eigencast
