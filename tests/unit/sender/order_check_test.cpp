// SPDX-License-Identifier: MIT
#include "sender/order_check.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "common/surface/shapes.h"

namespace eigencast {
namespace {

using testing::HasSubstr;
using testing::IsEmpty;

std::vector<float> floats_of(const std::vector<Vec3>& pose) {
  std::vector<float> values;
  for (const Vec3& p : pose) {
    for (const double x : p) values.push_back(static_cast<float>(x));
  }
  return values;
}

/// The heart with its vertices in another order from frame `from` on.
class Reordered final : public MotionClip {
 public:
  explicit Reordered(std::size_t from) : clip_(std::move(*builtin_clip("heart"))), from_(from) {}
  const Surface& rest() const override { return clip_->rest(); }
  std::size_t frame_count() const override { return 20; }
  double frame_rate_hz() const override { return 30; }
  Result<std::vector<Vec3>> pose(std::size_t frame) const override {
    auto pose = clip_->pose(frame);
    if (pose && frame >= from_) std::reverse(pose->begin(), pose->end());
    return pose;
  }
  std::string name() const override { return "reordered"; }

 private:
  std::unique_ptr<MotionClip> clip_;
  std::size_t from_;
};

TEST(OrderCheck, FramesOfAnotherOrderAreNamedAndAMajorityOfThemRefused) {
  const std::vector<std::size_t> frames{0, 5, 10, 15, 19};
  EXPECT_THAT(*look_at_frames(Reordered(20).rest(), Reordered(20), frames, false), IsEmpty());
  const auto some = look_at_frames(Reordered(15).rest(), Reordered(15), frames, false);
  ASSERT_TRUE(some) << some.error().message;
  EXPECT_THAT(*some, HasSubstr("frame 15: "));
  EXPECT_THAT(*some, HasSubstr("(and 1 more of the 5 frames looked at)"));
  const auto most = look_at_frames(Reordered(10).rest(), Reordered(10), frames, false);
  ASSERT_FALSE(most);
  EXPECT_EQ(most.error().code, ErrorCode::kInvalidArgument);
  EXPECT_THAT(most.error().message, HasSubstr("3 of the 5 frames looked at"));
  EXPECT_THAT(most.error().message, HasSubstr("--any-order"));
  const auto taken = look_at_frames(Reordered(10).rest(), Reordered(10), frames, true);
  ASSERT_TRUE(taken);
  EXPECT_THAT(*taken, HasSubstr("frame 10: "));
}

TEST(OrderCheck, ArrivingPosesAreNamedWhereTheyBeginToMisfit) {
  const Reordered clip(40);
  const std::vector<float> good = floats_of(*clip.pose(3));
  std::vector<float> reversed = floats_of([&] {
    auto pose = *clip.pose(3);
    std::reverse(pose.begin(), pose.end());
    return pose;
  }());
  ArrivalCheck check(clip.rest(), false);
  EXPECT_EQ(*check.look(good, 0, 0), std::nullopt);
  const auto begins = check.look(reversed, 1, 1000);
  ASSERT_TRUE(begins && *begins);
  EXPECT_THAT(**begins, HasSubstr("pose 1: "));
  EXPECT_EQ(*check.look(reversed, 2, 2000), std::nullopt) << "said once";
  EXPECT_EQ(*check.look(good, 3, 3000), std::nullopt);
  EXPECT_TRUE(*check.look(reversed, 4, 4000)) << "and again when it begins again";
  EXPECT_EQ(check.misfits(), 3u);
  for (std::uint64_t i = 5; i < 1005; ++i) (void)check.look(reversed, i, 5000);
  EXPECT_EQ(check.misfits(), 28u) << "the first 30 were looked at, 2 of them good";
  (void)check.look(reversed, 1005, 300'000);
  EXPECT_EQ(check.misfits(), 29u) << "then one in a while";
}

TEST(OrderCheck, AFirstPoseOfAnotherOrderIsRefusedUnlessAnyIsTaken) {
  const Reordered clip(0);
  const std::vector<float> reversed = floats_of(*clip.pose(0));
  const auto refused = ArrivalCheck(clip.rest(), false).look(reversed, 0, 0);
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, HasSubstr("the first pose"));
  EXPECT_TRUE(ArrivalCheck(clip.rest(), true).look(reversed, 0, 0));
}

}  // namespace
}  // namespace eigencast
