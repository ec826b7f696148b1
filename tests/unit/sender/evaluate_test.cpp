// SPDX-License-Identifier: MIT
#include "sender/evaluate.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/codec/pose_memory.h"
#include "common/surface/shapes/shapes.h"
#include "tests/support/process.h"

namespace eigencast {
namespace {

class Evaluate : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    clip_ = std::move(*builtin_clip("torus", 5));
    asset_ = std::move(bake(clip_->rest(), {.basis = BasisKind::kAugmented, .rank = 60, .name = {}})->asset);
  }
  static void TearDownTestSuite() { clip_.reset(); }
  static Evaluation evaluated(const EvaluateOptions& options) {
    auto result = evaluate(*clip_, asset_, options);
    EXPECT_TRUE(result) << result.error().message;
    return std::move(*result);
  }

  static inline std::unique_ptr<MotionClip> clip_;
  static inline Asset asset_;
};

TEST_F(Evaluate, DistancesAreOrderedAtEveryLevel) {
  const double eps = 1e-3 * asset_.diagonal();
  const Evaluation evaluation = evaluated({CodecKind::kQuantised, eps, {1, 0.3, 0.05}});
  ASSERT_EQ(evaluation.levels.size(), 3u);
  for (const LevelError& level : evaluation.levels) {
    EXPECT_GT(level.vertex.mean, 0);
    EXPECT_LE(level.vertex.mean, level.vertex.rms);
    EXPECT_LE(level.vertex.rms, level.vertex.max);
    EXPECT_GT(level.edges.spatial, 0);
    EXPECT_GT(level.edges.temporal, 0);
  }
  // At full detail a vertex's own counterpart is a point of the other surface.
  EXPECT_LE(evaluation.levels[0].hausdorff, evaluation.levels[0].vertex.max);
  EXPECT_EQ(evaluation.levels[0].vertex.rms, evaluation.total.rms);
  // Coarse triangles cut corners, which their vertices do not show.
  EXPECT_GT(evaluation.levels[2].hausdorff, 2 * evaluation.levels[0].hausdorff);
  EXPECT_LT(evaluation.levels[2].vertices, evaluation.levels[1].vertices);
  EXPECT_EQ(evaluation.rms_by_frame.size(), clip_->frame_count());
}

TEST_F(Evaluate, StepFollowsParseval) {
  const double step = 1e-3;
  const double eps = eps_from_step(asset_, step);
  EXPECT_NEAR(eps / asset_.diagonal(), 0.5e-3 * std::sqrt(60), 1e-9);
  const Evaluation evaluation = evaluated({CodecKind::kQuantised, eps, {1}});
  EXPECT_LE(evaluation.keys.quantising_rms, eps);
  EXPECT_GT(evaluation.keys.quantising_rms, 0.1 * eps);
}

TEST_F(Evaluate, StillPoseSettles) {
  for (const CodecKind codec : {CodecKind::kQuantised, CodecKind::kFloat32}) {
    const Evaluation evaluation = evaluated({codec, 1e-3 * asset_.diagonal(), {1}});
    EXPECT_EQ(evaluation.still.moves, 0);
    EXPECT_LE(evaluation.still.settles_after, 10u);
  }
}

TEST_F(Evaluate, MotionAgainIsCodedFromMemory) {
  EvaluateOptions options{CodecKind::kQuantised, 1e-3 * asset_.diagonal(), {1}};
  options.again = {0.87, 5e-4, 3};
  const Evaluation evaluation = evaluated(options);
  ASSERT_TRUE(evaluation.again);
  const AgainEvaluation& again = *evaluation.again;
  const std::size_t frames = clip_->frame_count();
  EXPECT_EQ(again.poses, std::min(frames, PoseMemory::kMaxPoses));
  for (const CodedKeys* keys : {&again.plain, &again.recalled, &again.equal})
    EXPECT_EQ(keys->frames, 2 * (static_cast<std::uint64_t>(static_cast<double>(frames - 1) / 0.87) + 1));
  EXPECT_EQ(again.plain.recalled, 0u);
  EXPECT_GT(2 * again.recalled.recalled, again.recalled.frames);
  EXPECT_LT(2 * again.recalled.payload_bytes, again.plain.payload_bytes);
  EXPECT_LE(again.equal.quantising_rms, again.plain.quantising_rms);
  EXPECT_LE(again.equal.wire_bytes, again.plain.wire_bytes);
  EXPECT_GE(again.first_use, frames);
  EXPECT_GT(again.memory_bytes, 0u);
  EXPECT_GT(again.payback_s(30).value(), 0);
  EXPECT_GT(again.in_all_kbit_per_s(evaluation.keys, 30), again.recalled.wire_kbit_per_s(30));
  options.again.reset();
  EXPECT_EQ(evaluated(options).keys.wire_bytes, evaluation.keys.wire_bytes) << "the first pass is as ever";
  options.again = {1, 0, 2};
  options.codec = CodecKind::kFloat32;
  EXPECT_EQ(evaluate(*clip_, asset_, options).error().code, ErrorCode::kInvalidArgument);
}

TEST_F(Evaluate, LoopIsCodedWithAMemoryThatIsKeptLive) {
  EvaluateOptions options{CodecKind::kQuantised, 1e-3 * asset_.diagonal(), {1}};
  options.loop = {40, 30};
  const Evaluation evaluation = evaluated(options);
  ASSERT_TRUE(evaluation.loop);
  const LoopEvaluation& loop = *evaluation.loop;
  EXPECT_EQ(loop.plain.frames, 40u * 30 - 1);
  EXPECT_EQ(loop.live.frames, loop.plain.frames);
  EXPECT_EQ(loop.error.poses, 40u * 30);
  EXPECT_GT(2 * loop.live.recalled, loop.live.frames);
  EXPECT_GT(loop.memory_bytes, 0u);
  EXPECT_GT(loop.poses, 0u);
  EXPECT_LT(loop.in_all_kbit_per_s(), loop.plain.wire_kbit_per_s(30));
  EXPECT_GT(loop.in_all_kbit_per_s(), loop.live.wire_kbit_per_s(30)) << "the memory is counted";
  EXPECT_LT(loop.live.quantising_rms, 1.02 * loop.plain.quantising_rms);
  ASSERT_TRUE(loop.first_use_s && loop.paid_back_s);
  const double frames_s = static_cast<double>(clip_->frame_count()) / 30;
  EXPECT_GT(*loop.first_use_s, std::min(1.0, frames_s));
  EXPECT_GE(*loop.paid_back_s, *loop.first_use_s);
  double kbit = 0;
  for (const double second : loop.kbit_per_s) kbit += second;
  EXPECT_NEAR(kbit, static_cast<double>(loop.live.wire_bytes + loop.memory_bytes) * 8e-3, 1e-6);
  EXPECT_EQ(loop.plain_kbit_per_s.size(), 40u);
}

/// The torus, which jolts, and whose wave the few columns of its basis miss; from some frame on another motion.
class Changed : public MotionClip {
 public:
  Changed(const MotionClip& clip, std::size_t frames, std::size_t changed)
      : clip_(clip), frames_(frames), changed_(changed) {}
  const Surface& rest() const override { return clip_.rest(); }
  std::size_t frame_count() const override { return frames_; }
  double frame_rate_hz() const override { return 30; }
  std::string name() const override { return clip_.name(); }
  Result<std::vector<Vec3>> pose(std::size_t frame) const override {
    auto pose = clip_.pose(frame % clip_.frame_count());
    if (!pose) return pose;
    const auto square = static_cast<double>(frame * frame);
    for (Vec3& p : *pose) {
      const double bend = frame < changed_ ? 0 : std::sin(9 * p[0]) / 20;
      p = {p[0] + 0.1 * std::sin(2.3 * square) * p[2], p[1] + 0.1 * std::sin(5.1 * square) * p[0] + bend, p[2]};
    }
    return pose;
  }

 private:
  const MotionClip& clip_;
  std::size_t frames_, changed_;
};

TEST_F(Evaluate, ColumnsAreLearntWithoutLookingAhead) {
  const auto clip = std::move(*builtin_clip("torus", 30));
  const auto baked = bake(clip->rest(), {.rank = 16, .name = {}});
  ASSERT_TRUE(baked) << baked.error().message;
  constexpr std::size_t kWindow = 20;
  EvaluateOptions options{CodecKind::kQuantised, 1e-3 * baked->asset.diagonal(), {1}};
  options.learn = {kWindow / 30.0, 30, &baked->encoded};
  options.again = {0.87, 5e-4, 2};
  const auto same = evaluate(Changed(*clip, 40, 40), baked->asset, options);
  const auto other = evaluate(Changed(*clip, 40, kWindow), baked->asset, options);
  ASSERT_TRUE(same) << same.error().message;
  ASSERT_TRUE(other && same->learn && other->learn);
  const LearnEvaluation& learn = *same->learn;
  EXPECT_EQ(learn.poses, kWindow);
  ASSERT_GT(learn.columns, 0u);
  EXPECT_GT(learn.bytes, 0u);
  EXPECT_EQ(other->learn->columns, learn.columns);
  EXPECT_EQ(other->learn->bytes, learn.bytes) << "what comes later changes no column";
  EXPECT_EQ(other->learn->trial->equal_kbit_per_s, learn.trial->equal_kbit_per_s);
  ASSERT_TRUE(learn.rest && learn.again);
  EXPECT_EQ(learn.rest->plain.error.poses, 40 - kWindow);
  EXPECT_LT(learn.rest->learnt.error.kg_percent, 0.8 * learn.rest->plain.error.kg_percent);
  EXPECT_LE(learn.rest->other.keys.wire_bytes, learn.rest->plain.keys.wire_bytes);
  EXPECT_LT(learn.rest->other.error.kg_percent, learn.rest->plain.error.kg_percent);
  EXPECT_LT(learn.again->learnt.error.kg_percent, 0.8 * learn.again->plain.error.kg_percent);
  EXPECT_LT(learn.again->plain.keys.wire_bytes, learn.again->other.keys.wire_bytes) << "a memory";
  options.codec = CodecKind::kFloat32;
  EXPECT_EQ(evaluate(*clip, baked->asset, options).error().code, ErrorCode::kInvalidArgument);
}

TEST_F(Evaluate, StopsWhenItIsTold) {
  const auto stopped = evaluate(*clip_, asset_, {CodecKind::kFloat32, 1, {1}},
                                [](double fraction, std::string_view) { return fraction < 0.5; });
  ASSERT_FALSE(stopped);
  EXPECT_EQ(stopped.error().code, ErrorCode::kCancelled);
}

TEST_F(Evaluate, PointsAreHeldAgainstPoints) {
  auto baked = bake({clip_->rest().positions, {}}, {.basis = BasisKind::kAugmented, .rank = 40, .name = {}});
  ASSERT_TRUE(baked) << baked.error().message;
  const auto evaluation = evaluate(*clip_, baked->asset, {CodecKind::kQuantised, 1e-3 * asset_.diagonal(), {1, 0.2}});
  ASSERT_TRUE(evaluation) << evaluation.error().message;
  EXPECT_LE(evaluation->levels[0].hausdorff, evaluation->levels[0].vertex.max);
  EXPECT_GT(evaluation->levels[1].hausdorff, evaluation->levels[0].hausdorff);
  EXPECT_EQ(evaluation->levels[0].edges.combined(), 0);
}

TEST_F(Evaluate, DetailInFramesLeavesLeast) {
  // Few columns, so that they leave out more than the codec does.
  std::vector<double> rms;
  for (const DetailKind kind : {DetailKind::kNone, DetailKind::kNormal, DetailKind::kFrames}) {
    auto baked = bake(clip_->rest(), {.basis = BasisKind::kHarmonic, .rank = 24, .name = {}, .detail = kind});
    ASSERT_TRUE(baked) << baked.error().message;
    const auto evaluation = evaluate(*clip_, baked->asset, {CodecKind::kFloat32, 1, {1, 0.3}});
    ASSERT_TRUE(evaluation) << evaluation.error().message;
    rms.push_back(evaluation->total.rms);
    EXPECT_NEAR(evaluation->levels[1].vertex.rms, rms.back(), 0.3 * rms.back()) << "vertices are where they are";
  }
  EXPECT_LT(rms[1], rms[0]);
  EXPECT_LT(rms[2], 0.9 * rms[0]);
}

TEST_F(Evaluate, ReportHasARowForEachLevel) {
  EvaluatedClip clip{"torus", "quantised", 30, true, {}};
  const std::vector<TrialPoint> points{{60, 6, 1e-3, 2e-3, 20}, {40, 4, 1e-3, 3e-3, 12}, {20, 2, 1e-3, 9e-3, 15}};
  const RankTrial trial = choose(points, {1, 2.5e-3, 0});
  for (const double over_diagonal : {2e-3, 1e-3}) {
    const double eps = over_diagonal * asset_.diagonal();
    clip.rows.push_back({"augmented", "none", 60, asset_.diagonal(), 1000, eps, trial,
                         evaluated({CodecKind::kQuantised, eps, {1, 0.5}})});
  }
  const auto report = nlohmann::json::parse(report_of(clip));
  ASSERT_EQ(report["results"].size(), 2u);
  EXPECT_EQ(report["results"][1]["levels"][1]["lod"], 0.5);
  EXPECT_NEAR(report["results"][1]["error_over_diagonal"].get<double>(), 1e-3, 1e-12);
  const std::string table = table_of(clip);
  // A line of why, a head and the two points of the front for each.
  EXPECT_EQ(std::count(table.begin(), table.end(), '\n'), 2 + 4 + 2 + 2 * 4);
  const auto& sweep = report["results"][0]["trial"];
  EXPECT_EQ(sweep["points"].size(), 3u);
  EXPECT_EQ(sweep["front"].size(), 2u);
  EXPECT_EQ(sweep["chosen"]["rank"], 60);
  EXPECT_TRUE(sweep["is_met"].get<bool>());
}

}  // namespace
}  // namespace eigencast
