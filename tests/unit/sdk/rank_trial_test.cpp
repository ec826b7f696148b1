// SPDX-License-Identifier: MIT
#include "sdk/rank_trial.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <tuple>

#include "common/core/files.h"
#include "common/reconstruction/reconstruct.h"
#include "common/surface/shapes/shapes.h"
#include "sdk/asset_folder.h"
#include "sdk/bake.h"
#include "tests/support/process.h"

namespace eigencast {
namespace {

BakeOptions of_wish(const BakeWish& wish, const KnownMotion* samples = nullptr) {
  BakeOptions options;
  options.wish = wish;
  options.samples = samples;
  return options;
}

/// A wave that steepens as it runs through a surface.
KnownMotion waves(const Surface& surface, std::size_t frames, std::size_t broken = SIZE_MAX) {
  return {{}, frames, [&surface, broken](std::size_t i) -> Result<std::vector<Vec3>> {
            std::vector<Vec3> pose = surface.positions;
            for (Vec3& p : pose) p[1] += 0.1 * std::tanh(5 * std::sin(0.2 * static_cast<double>(i) + 3 * p[0]));
            if (i == broken) pose[7][0] = std::numeric_limits<double>::quiet_NaN();
            return pose;
          }};
}

class RankTrialOfATorus : public ::testing::Test {
 protected:
  BakeResult baked(const BakeWish& wish, const std::string& cache = {}) const {
    auto result = bake(surface_, of_wish(wish, &motion_), cache);
    EXPECT_TRUE(result) << result.error().message;
    return std::move(*result);
  }
  const Surface surface_ = make_torus(30, 15, 1.0, 0.4);
  const KnownMotion motion_ = waves(surface_, 8);
};

TEST_F(RankTrialOfATorus, AssetIsThatOfTheChoice) {
  const BakeResult result = baked({});
  ASSERT_TRUE(result.trial);
  const RankTrial& choice = *result.trial;
  EXPECT_TRUE(choice.is_met());
  EXPECT_FALSE(result.trial->is_made);
  EXPECT_EQ(static_cast<int>(result.asset.rank), choice.chosen.rank);
  EXPECT_DOUBLE_EQ(result.asset.coding_error, choice.chosen.coding * result.asset.diagonal());
  // Two hundred columns, coded to within 1e-3, are among the points: what is chosen needs no more bits.
  const TrialPoint& reference = result.trial->points.front();
  EXPECT_EQ(reference.coding, 1e-3);
  EXPECT_LE(choice.chosen.error, reference.error);
  EXPECT_LE(priced(choice.chosen.kbit_per_s, choice.chosen.rank), 1.02 * priced(reference.kbit_per_s, reference.rank));
}

TEST_F(RankTrialOfATorus, WishesOrderErrorsAndRates) {
  const TrialPoint coarse = baked({0.5, 0, 0}).trial->chosen, fine = baked({1.2, 0, 0}).trial->chosen;
  EXPECT_GT(coarse.error, fine.error);
  EXPECT_LT(coarse.kbit_per_s, fine.kbit_per_s);
  const RankTrial rate = *baked({1, 0, 20}).trial;
  EXPECT_LE(rate.chosen.kbit_per_s, 20);
  const RankTrial target = *baked({1, 1e-2, 0}).trial;
  EXPECT_LE(target.chosen.error, 1e-2);
  EXPECT_EQ(target.asked, 1e-2);
}

TEST(RankTrial, UnreachableErrorTakesAllColumns) {
  const Surface surface = make_torus(40, 18, 1.0, 0.4);
  const KnownMotion motion = waves(surface, 3);
  const auto result = bake(surface, of_wish({1, 1e-9, 0}, &motion));
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_FALSE(result->trial->is_met());
  EXPECT_GT(result->asset.rank, 300u);  // More than 300 where these do not do.
}

TEST_F(RankTrialOfATorus, CachedBakeHasTheTrial) {
  const testing::TemporaryFolder folder;
  const BakeResult first = baked({}, folder.file("cache")), again = baked({}, folder.file("cache"));
  ASSERT_TRUE(again.trial);
  EXPECT_TRUE(again.from_cache);
  EXPECT_EQ(again.encoded.manifest.id, first.encoded.manifest.id);
  EXPECT_EQ(again.asset.coding_error, first.asset.coding_error);
  EXPECT_EQ(again.trial->chosen, first.trial->chosen);
  EXPECT_EQ(again.trial->asked, first.trial->asked);
  EXPECT_EQ(again.trial->points, first.trial->points);
  EXPECT_FALSE(baked({2, 0, 0}, folder.file("cache")).from_cache);
}

TEST_F(RankTrialOfATorus, FolderKeepsTheCodingError) {
  const testing::TemporaryFolder folder;
  const BakeResult result = baked({});
  ASSERT_TRUE(write_asset(result.encoded, result.asset.coding_error, folder.file("out")));
  const Sha256 id = result.encoded.manifest.id;
  const auto read = read_asset(folder.file("out"), id);
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_GT(read->asset.coding_error, 0);
  EXPECT_EQ(read->asset.coding_error, result.asset.coding_error);
  for (const char* text :
       {"", "-1", "nan", "inf", "1e99\n", "1e-3", "1e-3 and many more characters than a number ever has, by far"}) {
    ASSERT_TRUE(write_file_atomically(folder.file("out/" + id.hex() + ".coding"), text));
    const auto damaged = read_asset(folder.file("out"), id);
    ASSERT_TRUE(damaged) << text;
    EXPECT_EQ(damaged->asset.coding_error, 0) << text;
  }
}

TEST(RankTrial, ErrorsAreThoseOfAllVerticesAndPoses) {
  // 19,200 vertices, of which not all judge; what they say holds for the rest.
  const Surface surface = make_torus(160, 120, 1.0, 0.4);
  const KnownMotion motion = waves(surface, 6);
  const auto result = bake(surface, of_wish({1, 3e-3, 0}, &motion));
  ASSERT_TRUE(result && result->trial);
  const auto projector = Projector::create(result->asset);
  ASSERT_TRUE(projector);
  Reconstructor receiver;
  receiver.update(result->asset);
  const Asset& asset = result->asset;
  std::vector<float> rebuilt(std::size_t{3} * asset.vertex_count);
  double squared = 0;
  for (std::size_t frame = 0; frame < motion.poses; ++frame) {
    const auto pose = motion.pose(frame);
    const auto C =
        projector->coefficients_from_positions(std::span<const double>(pose->front().data(), 3 * pose->size()));
    ASSERT_TRUE(C);
    receiver.rebuild(*C, 3, asset.rank, asset.vertex_count, rebuilt);
    for (std::size_t row = 0; row < asset.vertex_count; ++row) {
      for (std::size_t axis = 0; axis < 3; ++axis)
        squared += std::pow((*pose)[asset.source_vertex[row]][axis] - asset.origin[axis] - rebuilt[3 * row + axis], 2);
    }
  }
  const double basis = std::sqrt(squared / static_cast<double>(motion.poses * asset.vertex_count));
  const TrialPoint& chosen = result->trial->chosen;
  EXPECT_LT(basis / asset.diagonal(), 1.03 * chosen.error);
  EXPECT_GT(std::hypot(basis / asset.diagonal(), chosen.coding), 0.9 * chosen.error);
}

TEST(RankTrial, LoneSurfacesAreJudgedByDeformations) {
  for (const Surface& surface : {make_icosphere(2), Surface{make_icosphere(2).positions, {}}, make_icosphere(0)}) {
    const auto result = bake(surface, of_wish({}));
    ASSERT_TRUE(result) << result.error().message;
    ASSERT_TRUE(result->trial);
    EXPECT_TRUE(result->trial->is_made);
    EXPECT_TRUE(result->trial->is_met());
    EXPECT_GE(result->asset.rank, 4u);
  }
}

TEST(RankTrial, FewFramesAndBrokenOnesAreTaken) {
  const Surface surface = make_torus(12, 8, 1.0, 0.4);
  for (const auto& [frames, broken, is_made] :
       {std::tuple(2u, 99u, false), std::tuple(3u, 99u, false), std::tuple(2u, 1u, true), std::tuple(40u, 20u, false),
        std::tuple(1000u, 99u, false), std::tuple(1u, 99u, true)}) {
    const KnownMotion motion = waves(surface, frames, broken);
    const auto poses = sample_poses(surface, &motion);
    ASSERT_TRUE(poses);
    EXPECT_EQ(poses->is_made, is_made) << frames;
    EXPECT_LE(poses->count(), 128u);
    EXPECT_TRUE(poses->positions.allFinite());
    EXPECT_EQ(poses->run_ends.back(), poses->count());
    const auto result = bake(surface, of_wish({}, &motion));
    ASSERT_TRUE(result) << result.error().message;
    EXPECT_TRUE(result->trial->is_met());
  }
}

TEST(RankTrial, PosesOfAnotherSurfaceAreRefused) {
  const Surface surface = make_torus(30, 15, 1.0, 0.4);
  const KnownMotion other{{}, 5, [](std::size_t) { return Result(make_icosphere(2).positions); }};
  const auto result = bake(surface, of_wish({}, &other));
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kInvalidArgument);
}

TEST(RankTrial, WishesThatAreNoneAreRefused) {
  const Surface surface = make_icosphere(2);
  for (const BakeWish& wish : {BakeWish{0, 0, 0}, BakeWish{-1, 0, 0}, BakeWish{1, -1, 0}, BakeWish{1, 0, -1},
                               BakeWish{std::nan(""), 0, 0}, BakeWish{1, 0, HUGE_VAL}}) {
    const auto result = bake(surface, of_wish(wish));
    ASSERT_FALSE(result);
    EXPECT_EQ(result.error().code, ErrorCode::kInvalidArgument);
  }
  BakeOptions with_detail = of_wish({});
  with_detail.basis = BasisKind::kHarmonic;
  EXPECT_FALSE(bake(surface, with_detail));
  with_detail.detail = DetailKind::kNone;
  EXPECT_TRUE(bake(surface, with_detail));
}

// Ranks without a wish are what they were: no trial, ten groups.
TEST(RankTrial, NamedRanksAreTakenAsTheyAre) {
  const auto result = bake(make_icosphere(3), {});
  ASSERT_TRUE(result);
  EXPECT_FALSE(result->trial);
  EXPECT_EQ(result->asset.rank, 200u);
  EXPECT_EQ(result->asset.coding_error, 0);
}

}  // namespace
}  // namespace eigencast
