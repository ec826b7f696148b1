// SPDX-License-Identifier: MIT
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "common/surface/formats/clip.h"
#include "common/surface/formats/write.h"
#include "common/surface/shapes/shapes.h"
#include "tests/support/paths.h"
#include "tests/unit/surface/temp_dir.h"

namespace eigencast {
namespace {

/// The first frames of a clip, for speed.
class FirstFrames final : public MotionClip {
 public:
  FirstFrames(std::unique_ptr<MotionClip> clip, std::size_t frames) : clip_(std::move(clip)), frames_(frames) {}
  const Surface& rest() const override { return clip_->rest(); }
  std::size_t frame_count() const override { return frames_; }
  double frame_rate_hz() const override { return clip_->frame_rate_hz(); }
  Result<std::vector<Vec3>> pose(std::size_t frame) const override { return clip_->pose(frame); }
  std::string name() const override { return clip_->name(); }

 private:
  std::unique_ptr<MotionClip> clip_;
  std::size_t frames_;
};

/// What a clip writes and open_clip gives back must be the same to the bit, in each of the formats.
void expect_round_trips(const MotionClip& clip, bool exact) {
  const TempDir dir;
  for (const std::string name : {"a.pc2", "b.mdd", "c.npy", "d/", "e/e.obj", "f/f.ply", "g/g.off"}) {
    const auto written = write_clip(clip, dir.file(name));
    ASSERT_TRUE(written) << written.error().message;
    const bool is_sequence = name.find('/') != std::string::npos;
    const auto again = open_clip(is_sequence ? dir.file(name.substr(0, 1)) : dir.file(name));
    ASSERT_TRUE(again) << again.error().message;
    ASSERT_EQ((*again)->frame_count(), clip.frame_count()) << name;
    EXPECT_EQ((*again)->rest().faces, clip.rest().faces) << name;
    if (!is_sequence) {
      EXPECT_EQ((*again)->rest().positions, clip.rest().positions) << name;
    }
    for (std::size_t t = 0; t < clip.frame_count(); ++t) {
      auto expected = *clip.pose(t);
      if (!exact && !is_sequence) {
        for (Vec3& p : expected) {
          for (double& x : p) x = static_cast<float>(x);
        }
      }
      ASSERT_EQ(*(*again)->pose(t), expected) << name << " " << t;
    }
  }
}

TEST(RoundTrip, UnwritablePathsAreKnownBefore) {
  const TempDir dir;
  for (const char* name : {"a.pc2", "b.mdd", "c.npy", "d/", "new/e.obj", "new/deep/f.ply", "g.off"})
    EXPECT_TRUE(check_clip_path(dir.file(name))) << name;
  for (const char* name : {"a.abc", "none", "no/folder.pc2"}) {
    EXPECT_FALSE(check_clip_path(dir.file(name))) << name;
    EXPECT_FALSE(write_clip(*builtin_clip("sphere").value(), dir.file(name))) << name;
  }
  EXPECT_FALSE(check_clip_path("/dev/null/e.obj"));
  EXPECT_TRUE(check_surface_path(dir.file("a.ply")));
  EXPECT_FALSE(check_surface_path(dir.file("a.npy"))) << "no surface";
  EXPECT_FALSE(check_surface_path(dir.file("no/a.ply")));
  EXPECT_TRUE(std::filesystem::is_empty(dir.file(""))) << "looking makes nothing";
}

TEST(RoundTrip, BuiltInShapeAsFloatsAndAsText) {
  expect_round_trips(FirstFrames(std::move(*builtin_clip("sphere")), 3), false);
}

TEST(RoundTrip, HorseGallopToTheBit) {
  expect_round_trips(FirstFrames(std::move(*open_clip(gait_clip().string())), 6), true);
}

TEST(RoundTrip, FailedWritesAreErrorsAndLeaveNothing) {
  const TempDir dir;
  const auto clip = builtin_clip("sphere");
  EXPECT_EQ(write_clip(**clip, dir.file("a.abc")).error().code, ErrorCode::kUnsupported);
  EXPECT_EQ(write_clip(**clip, dir.file("no/such/a.pc2")).error().code, ErrorCode::kIo);
  EXPECT_EQ(write_clip(**clip, dir.file("b.pc2"), [](double fraction) { return fraction < 0.5; }).error().code,
            ErrorCode::kCancelled);
  EXPECT_TRUE(std::filesystem::is_empty(dir.path()));
}

}  // namespace
}  // namespace eigencast
