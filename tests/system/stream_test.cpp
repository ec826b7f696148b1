// SPDX-License-Identifier: MIT
// One sender, one broker, viewers of different kinds: what comes out is the sender's surface.
#include <gtest/gtest.h>

#include <cmath>
#include <csignal>
#include <fstream>
#include <nlohmann/json.hpp>

#include "common/codec/key.h"
#include "common/reconstruction/reconstruct.h"
#include "common/surface/formats/clip.h"
#include "common/surface/shapes/shapes.h"
#include "sdk/asset_cache.h"
#include "sdk/bake.h"
#include "sdk/publisher.h"
#include "tests/support/paths.h"
#include "tests/system/scene.h"

namespace eigencast::testing {
namespace {

constexpr milliseconds kPatience{60000};

std::unique_ptr<MotionClip> open_animation(const std::string& folder) {
  auto clip = open_clip(folder + "/vertices.npy");
  EXPECT_TRUE(clip) << clip.error().message;
  return clip ? std::move(*clip) : nullptr;
}

nlohmann::json report_of(const Scene& scene, const std::string& client) {
  std::ifstream in(scene.file(client + ".json"));
  return nlohmann::json::parse(in, nullptr, false);
}

/// Streams horse-gallop in the given basis to one viewer at full detail and one late viewer at a fifth of the vertices.
class Horse : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = animation("horse-gallop");
    if (folder_.empty()) GTEST_SKIP() << "EIGENCAST_DATA_DIR is unset";
  }

  /// detail: of harmonic bases.
  void stream(BasisKind kind, Scene& scene, const std::string& detail = "none") {
    const std::string input = folder_ + "/vertices.npy", basis(name_of(kind));
    ASSERT_EQ(scene.run("bake", {"eigencast-sender", "bake", input, "--basis", basis, "--detail", detail}), 0)
        << scene.logs();
    const auto broker = scene.start_broker();
    const auto sender = scene.start_sender({input, "--basis", basis, "--detail", detail, "--rate", "30"});
    const auto full = scene.start_client("full", {"--frames", "1000000", "--lod", "1"});
    ASSERT_TRUE(eventually([&] { return scene.received("full").size() > 60; }, kPatience)) << scene.logs();
    const auto coarse = scene.start_client("coarse", {"--frames", "20", "--lod", "0.2", "--rate", "raw"});
    ASSERT_EQ(coarse->wait(kPatience), 0) << scene.logs();
    full->signal(SIGTERM);
    ASSERT_EQ(full->wait(kPatience), 0) << scene.logs();
    sender->signal(SIGTERM);
    EXPECT_EQ(sender->wait(kPatience), 0) << scene.logs();
    broker->signal(SIGTERM);
    EXPECT_EQ(broker->wait(kPatience), 0) << scene.logs();
  }

  /// The error of all keys that the viewer at full detail received.
  Comparison compare(BasisKind basis, const Scene& scene, DetailKind detail = DetailKind::kNone) {
    const auto clip = open_animation(folder_);
    const KnownMotion motion = motion_of(*clip);
    const BakeOptions options{.basis = basis, .rank = 200, .name = {}, .motion = &motion, .detail = detail};
    const auto baked = bake(clip->rest(), options, default_cache_dir());
    EXPECT_TRUE(baked) << baked.error().message;
    const auto comparison = compare_with_truth(*clip, baked->asset, scene.sent(), scene.received("full"));
    EXPECT_TRUE(comparison) << comparison.error().message;
    return *comparison;
  }

  std::string folder_;
};

TEST_F(Horse, AugmentedArrivesWithTheErrorThatTheBasisPredicts) {
  Scene scene;
  stream(BasisKind::kAugmented, scene);
  if (HasFatalFailure()) return;
  const Comparison comparison = compare(BasisKind::kAugmented, scene);
  EXPECT_GT(comparison.keys.poses, 20u);
  EXPECT_EQ(comparison.unmatched, 0u);
  EXPECT_GT(comparison.keys.kg_percent, 0.85);
  EXPECT_LT(comparison.keys.kg_percent, 1.02);
}

TEST_F(Horse, HarmonicArrivesWithTheErrorThatTheBasisPredicts) {
  Scene scene;
  stream(BasisKind::kHarmonic, scene);
  if (HasFatalFailure()) return;
  const Comparison comparison = compare(BasisKind::kHarmonic, scene);
  EXPECT_GT(comparison.keys.poses, 20u);
  EXPECT_GT(comparison.keys.kg_percent, 2.05);
  EXPECT_LT(comparison.keys.kg_percent, 2.30);
}

/// Half of what the basis alone leaves (above): viewers put the rest back.
TEST_F(Horse, HarmonicWithDetailArrivesWithHalfTheError) {
  Scene scene;
  stream(BasisKind::kHarmonic, scene, "frames");
  if (HasFatalFailure()) return;
  const Comparison comparison = compare(BasisKind::kHarmonic, scene, DetailKind::kFrames);
  EXPECT_GT(comparison.keys.poses, 20u);
  EXPECT_GT(comparison.keys.kg_percent, 1.02);
  EXPECT_LT(comparison.keys.kg_percent, 1.15);
}

TEST_F(Horse, ViewersOfDifferentDetailAndTimeSeeTheSameMotion) {
  Scene scene;
  stream(BasisKind::kAugmented, scene);
  if (HasFatalFailure()) return;
  const auto full = by_step(scene.received("full"));
  const auto coarse = by_step(scene.received("coarse"));
  ASSERT_FALSE(coarse.empty());
  EXPECT_GT(coarse.begin()->first.first, full.begin()->first.first) << "the second viewer came later";
  std::size_t common = 0;
  for (const auto& [step, pose] : coarse) {
    ASSERT_TRUE(pose.is_key()) << "raw mode delivers keys only";
    const auto other = full.find(step);
    if (other == full.end()) continue;
    ++common;
    EXPECT_EQ(other->second.coefficients, pose.coefficients);
    EXPECT_EQ(other->second.capture_us, pose.capture_us);
  }
  EXPECT_GT(common, 10u);
  EXPECT_LT(report_of(scene, "coarse")["lod"]["vertices"].get<int>(), 2000);
  EXPECT_EQ(report_of(scene, "full")["lod"]["vertices"].get<int>(), 8431);
}

/// Between consecutive keys there are the poses 1/3 and 2/3 and no others, each equal to Eq. 7 of its neighbours to
/// rounding. Poses may be missing at any place (latest wins; how many depends on the machine's load), but some
/// intervals must be whole.
void expect_tripled(const std::vector<RecordedPose>& poses, double rounding) {
  const auto steps = by_step(poses);
  const std::uint64_t first = poses.front().sequence + 2, last = poses.back().sequence - 1;
  ASSERT_GT(last, first + 5);
  std::size_t whole = 0;
  for (std::uint64_t s = first; s <= last; ++s) {
    const auto before = steps.find({s - 1, {0, 0}}), after = steps.find({s, {0, 0}});
    if (before == steps.end() || after == steps.end()) continue;
    int found = 0;
    for (int at = 1; at < 3; ++at) {
      const auto middle = steps.find({s, {at, 3}});
      if (middle == steps.end()) continue;
      ++found;
      const double u = at / 3.0;
      for (std::size_t i = 0; i < middle->second.coefficients.size(); ++i) {
        const double a = before->second.coefficients[i], b = after->second.coefficients[i];
        ASSERT_NEAR(middle->second.coefficients[i], a + u * (b - a), rounding)
            << "value " << i << " of " << at << "/3 before " << s;
      }
    }
    whole += found == 2;
  }
  for (const RecordedPose& pose : poses) EXPECT_TRUE(pose.is_key() || pose.of == 3) << "a pose that is not a third";
  EXPECT_GE(whole, 3u) << "whole intervals of " << last - first + 1;
}

class Interpolated : public ::testing::TestWithParam<std::tuple<std::string, std::string>> {};

TEST_P(Interpolated, TheRateTriplesAndEveryPoseIsEquation7OfItsNeighbours) {
  const auto& [form, codec] = GetParam();
  Scene scene;
  const auto broker = scene.start_broker();
  const auto sender = scene.start_sender({"torus", "--rate", "20", "--codec", codec});
  const auto client = scene.start_client("a", {"--frames", "60", "--form", form});
  ASSERT_EQ(client->wait(kPatience), 0) << scene.logs();
  const auto clip = builtin_clip("torus");
  const KnownMotion motion = motion_of(**clip);
  const auto baked = bake((*clip)->rest(), {.name = {}, .motion = &motion}, default_cache_dir());
  ASSERT_TRUE(baked);
  // Compact poses are rounded to steps, full ones coded to within three half spacings of 2.5 times the keys' size.
  const Quantiser quantiser =
      quantiser_for_error(kDefaultErrorOverDiagonal * baked->asset.diagonal(), baked->asset.area, baked->asset.rank);
  const double steps = form == "compact" ? 0.5001 : 3 * 2.5 * quantiser.half_spacing;
  const double rounding = codec == "quantised" ? steps * step_size(quantiser.step) : codec == "float32" ? 1e-5 : 1e-12;
  const auto poses = scene.received("a");
  ASSERT_GT(poses.size(), 50u) << scene.logs();
  expect_tripled(poses, rounding);

  const auto report = report_of(scene, "a");
  EXPECT_EQ(report["bands"]["received"], 4) << report.dump(2);
}

INSTANTIATE_TEST_SUITE_P(Forms, Interpolated,
                         ::testing::Values(std::tuple{"full", "quantised"}, std::tuple{"compact", "quantised"},
                                           std::tuple{"full", "float64"}, std::tuple{"compact", "float32"}));

TEST(Raw, DeliversExactlyWhatWasSent) {
  Scene scene;
  const auto broker = scene.start_broker();
  const auto sender = scene.start_sender({"torus", "--rate", "30", "--codec", "float64"});
  const auto client = scene.start_client("a", {"--frames", "40", "--rate", "raw"});
  ASSERT_EQ(client->wait(kPatience), 0) << scene.logs();

  const auto clip = builtin_clip("torus");
  const KnownMotion motion = motion_of(**clip);
  const auto baked = bake((*clip)->rest(), {.name = {}, .motion = &motion}, default_cache_dir());
  ASSERT_TRUE(baked);
  const auto projector = Projector::create(baked->asset);
  ASSERT_TRUE(projector);
  const SentFrames sent = scene.sent();
  const auto poses = scene.received("a");
  ASSERT_GT(poses.size(), 30u);
  EXPECT_GE(share_of_keys(poses), 0.9) << scene.logs();
  for (const RecordedPose& pose : poses) {
    EXPECT_TRUE(pose.is_key());
    ASSERT_TRUE(sent.contains(pose.capture_us));
    const auto positions = (*clip)->pose(sent.at(pose.capture_us));
    std::vector<double> flat;
    for (const Vec3& vertex : *positions) flat.insert(flat.end(), vertex.begin(), vertex.end());
    const auto coefficients = projector->coefficients_from_positions(std::span<const double>(flat));
    ASSERT_TRUE(coefficients);
    EXPECT_EQ(pose.coefficients, *coefficients) << "to the last bit: the codec is float64";
  }
}

TEST(Bands, AViewerOfFewerBandsGetsTheFirstColumnsOfTheSamePoses) {
  Scene scene;
  const auto broker = scene.start_broker();
  const auto sender = scene.start_sender({"torus", "--rate", "30"});
  const auto all = scene.start_client("all", {"--frames", "40", "--rate", "raw"});
  const auto few = scene.start_client("few", {"--frames", "40", "--rate", "raw", "--bands", "2"});
  ASSERT_EQ(all->wait(kPatience), 0) << scene.logs();
  ASSERT_EQ(few->wait(kPatience), 0) << scene.logs();
  const auto whole = by_step(scene.received("all"));
  std::size_t common = 0;
  for (const auto& [step, pose] : by_step(scene.received("few"))) {
    const auto other = whole.find(step);
    if (other == whole.end()) continue;
    ++common;
    for (std::size_t i = 0; i < 54 * 3; ++i) EXPECT_EQ(pose.coefficients[i], other->second.coefficients[i]);
    for (std::size_t i = 54 * 3; i < pose.coefficients.size(); ++i)
      EXPECT_NEAR(pose.coefficients[i], 0, 1e-6) << "rest pose";
  }
  EXPECT_GT(common, 20u);
  EXPECT_LT(report_of(scene, "few")["kbit_per_s"].get<double>(), report_of(scene, "all")["kbit_per_s"].get<double>());
}

}  // namespace
}  // namespace eigencast::testing
