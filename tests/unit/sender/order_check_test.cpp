// SPDX-License-Identifier: MIT
#include "sender/order_check.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "tests/unit/sender/reordered.h"

namespace eigencast {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;

std::vector<float> floats_of(const std::vector<Vec3>& pose) {
  std::vector<float> values;
  for (const Vec3& p : pose) {
    for (const double x : p) values.push_back(static_cast<float>(x));
  }
  return values;
}

TEST(OrderCheck, SamplesAreSpreadOverTheClip) {
  EXPECT_EQ(sample_frames(3, 24), (std::vector<std::size_t>{0, 1, 2}));
  const std::vector<std::size_t> frames = sample_frames(1000, 24);
  EXPECT_EQ(frames.size(), 24u);
  EXPECT_EQ(frames.back(), 999u);
  for (std::size_t i = 1; i < frames.size(); ++i) EXPECT_LE(frames[i] - frames[i - 1], 42u);
}

TEST(OrderCheck, MajorityInAnotherOrderIsRefused) {
  const std::vector<std::size_t> frames{0, 5, 10, 15, 19};
  EXPECT_THAT(*check_frames(Reordered(20).rest(), Reordered(20), frames, false), IsEmpty());
  const auto some = check_frames(Reordered(15).rest(), Reordered(15), frames, false);
  ASSERT_TRUE(some) << some.error().message;
  EXPECT_THAT(*some, HasSubstr("frame 15: "));
  const auto most = check_frames(Reordered(10).rest(), Reordered(10), frames, false);
  ASSERT_FALSE(most);
  EXPECT_EQ(most.error().code, ErrorCode::kInvalidArgument);
  const auto taken = check_frames(Reordered(10).rest(), Reordered(10), frames, true);
  ASSERT_TRUE(taken);
  EXPECT_THAT(*taken, HasSubstr("frame 10: "));
}

TEST(OrderCheck, MisfitIsReportedWhereItBegins) {
  const Reordered clip(40);
  const std::vector<float> good = floats_of(*clip.pose(3));
  std::vector<float> reversed = floats_of([&] {
    auto pose = *clip.pose(3);
    std::reverse(pose.begin(), pose.end());
    return pose;
  }());
  ArrivalCheck check(clip.rest(), false);
  constexpr TimeUs kApart = 33'333;
  EXPECT_EQ(*check.check(good, 0, 0), std::nullopt);
  const auto begins = check.check(reversed, 1, kApart);
  ASSERT_TRUE(begins && *begins);
  EXPECT_THAT(**begins, HasSubstr("pose 1: "));
  EXPECT_EQ(*check.check(reversed, 2, 2 * kApart), std::nullopt) << "said once";
  EXPECT_EQ(*check.check(good, 3, 3 * kApart), std::nullopt);
  EXPECT_TRUE(*check.check(reversed, 4, 4 * kApart)) << "and again when it begins again";
  EXPECT_EQ(check.misfits(), 3u);
  for (TimeUs i = 5; i < 30; ++i) (void)check.check(reversed, static_cast<std::uint64_t>(i), i * kApart);
  for (std::uint64_t i = 30; i < 1000; ++i) (void)check.check(reversed, i, 30 * kApart);
  EXPECT_EQ(check.misfits(), 28u) << "the first 30 were checked, 2 of them good";
  (void)check.check(reversed, 1005, 40 * kApart);
  EXPECT_EQ(check.misfits(), 29u) << "then one in a while";
}

TEST(OrderCheck, LargeMeshesAreCheckedLessOften) {
  const auto seconds = [](std::uint64_t checked, std::size_t size) {
    return static_cast<double>(pause_between_checks(checked, size)) * 1e-6;
  };
  EXPECT_LE(seconds(1, 30'000), 1.0 / 30) << "each of the first poses at the usual rate";
  EXPECT_DOUBLE_EQ(seconds(30, 30'000), 0.2);
  EXPECT_GE(seconds(1, 3'000'000), 1) << "a check takes up to 0.3 s";
  EXPECT_GE(seconds(30, 3'000'000), 10);
}

TEST(OrderCheck, FirstPoseInAnotherOrderIsRefused) {
  const Reordered clip(0);
  const std::vector<float> reversed = floats_of(*clip.pose(0));
  const auto refused = ArrivalCheck(clip.rest(), false).check(reversed, 0, 0);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kInvalidArgument);
  EXPECT_TRUE(ArrivalCheck(clip.rest(), true).check(reversed, 0, 0));
}

}  // namespace
}  // namespace eigencast
