// SPDX-License-Identifier: MIT
#include "tools/compare/compare.h"

#include <gtest/gtest.h>

#include <fstream>

#include "common/reconstruction/reconstruct.h"
#include "common/surface/shapes/shapes.h"
#include "sdk/bake.h"
#include "sender/evaluate.h"
#include "tests/support/process.h"

namespace eigencast {
namespace {

/// A torus baked small, its clip, and what a perfect network would deliver of its first frames.
class Compare : public ::testing::Test {
 protected:
  /// Baking is the dear part: once for all cases.
  static void SetUpTestSuite() {
    clip_ = std::move(*builtin_clip("torus"));
    auto baked = bake(clip_->rest(), {.basis = BasisKind::kAugmented, .rank = 100, .name = {}});
    ASSERT_TRUE(baked) << baked.error().message;
    asset_ = std::move(baked->asset);
  }
  static void TearDownTestSuite() { clip_.reset(); }

  void SetUp() override {
    const auto projector = Projector::create(asset_);
    ASSERT_TRUE(projector);
    for (std::size_t frame = 0; frame < 4; ++frame) {
      std::vector<double> flat;
      const std::vector<Vec3> positions = *clip_->pose(frame);  // Not in the loop's head: the Result must outlive it.
      for (const Vec3& vertex : positions) flat.insert(flat.end(), vertex.begin(), vertex.end());
      received_.push_back({frame + 1, 0, 0, static_cast<TimeUs>(1000 * frame), 3,
                           *projector->coefficients_from_positions(std::span<const double>(flat))});
      sent_[static_cast<TimeUs>(1000 * frame)] = frame;
    }
  }

  static inline std::unique_ptr<MotionClip> clip_;
  static inline Asset asset_;
  SentFrames sent_;
  std::vector<RecordedPose> received_;
};

TEST_F(Compare, UnchangedPosesHaveTheBasisError) {
  const auto comparison = compare_with_truth(*clip_, asset_, sent_, received_);
  ASSERT_TRUE(comparison);
  EXPECT_EQ(comparison->keys.poses, 4u);
  EXPECT_EQ(comparison->interpolated.poses, 0u);
  EXPECT_GT(comparison->keys.kg_percent, 0);
  EXPECT_LT(comparison->keys.kg_percent, 1);
}

TEST_F(Compare, InterpolatedPoseMeetsInterpolatedTruth) {
  RecordedPose middle = received_[1];
  middle.at = 1, middle.of = 2, middle.capture_us = 500;
  for (std::size_t i = 0; i < middle.coefficients.size(); ++i) {
    middle.coefficients[i] = 0.5 * (received_[0].coefficients[i] + received_[1].coefficients[i]);
  }
  const auto comparison = compare_with_truth(*clip_, asset_, sent_, {received_[0], middle, received_[1]});
  ASSERT_TRUE(comparison);
  EXPECT_EQ(comparison->interpolated.poses, 1u);
  EXPECT_LT(comparison->interpolated.kg_percent, 1);
}

TEST_F(Compare, WrongPoseIsAnError) {
  std::swap(received_[0].coefficients, received_[3].coefficients);
  const auto right = compare_with_truth(*clip_, asset_, sent_, {received_[1], received_[2]});
  const auto wrong = compare_with_truth(*clip_, asset_, sent_, received_);
  ASSERT_TRUE(right && wrong);
  EXPECT_GT(wrong->keys.kg_percent, 5 * right->keys.kg_percent);
}

TEST_F(Compare, RecordsOfAnotherRunAreRefused) {
  const auto comparison = compare_with_truth(*clip_, asset_, {{7, 0}}, received_);
  ASSERT_FALSE(comparison);
  EXPECT_EQ(comparison.error().code, ErrorCode::kInvalidArgument);
}

TEST_F(Compare, EvaluationAddsOnlyQuantisingError) {
  const double eps = 3e-4 * asset_.diagonal();
  const auto coarse = evaluate(*clip_, asset_, {CodecKind::kQuantised, eps});
  const auto exact = evaluate(*clip_, asset_, {CodecKind::kFloat64, eps});
  ASSERT_TRUE(coarse && exact);
  EXPECT_EQ(exact->total.kg_percent, exact->truncation.kg_percent);
  EXPECT_GT(coarse->total.rms, coarse->truncation.rms);
  // Orthogonal errors: total^2 = truncation^2 + quantisation^2, the latter at most eps^2 in the area-weighted mean.
  EXPECT_LT(coarse->total.rms * coarse->total.rms, coarse->truncation.rms * coarse->truncation.rms + 2 * 9e-8);
  EXPECT_LT(coarse->keys.payload_bytes, exact->keys.payload_bytes / 10);
}

TEST(CompareRecords, BrokenLineIsCorrupt) {
  const testing::TemporaryFolder folder;
  std::ofstream(folder.file("sent.jsonl")) << "{\"capture_us\":1,\"frame\":0}\n{\"capture_us\":2\n";
  const auto frames = read_sent_frames(folder.file("sent.jsonl"));
  ASSERT_FALSE(frames);
  EXPECT_EQ(frames.error().code, ErrorCode::kCorrupt);
  EXPECT_EQ(read_sent_frames(folder.file("absent")).error().code, ErrorCode::kNotFound);
}

}  // namespace
}  // namespace eigencast
