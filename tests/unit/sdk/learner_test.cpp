// SPDX-License-Identifier: MIT
#include "sdk/learner.h"

#include <gtest/gtest.h>

#include <cmath>
#include <utility>

#include "tests/unit/sdk/folded_torus.h"

namespace eigencast {
namespace {

constexpr std::size_t kPoses = 30;

double eps() {
  return 1e-3 * folded_torus().asset->diagonal();
}

Learner taught(const std::shared_ptr<const Asset>& asset, const std::vector<std::vector<float>>& poses) {
  const auto projector = Projector::create(*asset);
  Learner learner(asset);
  for (const std::vector<float>& pose : poses) learner.add(pose, *projector->coefficients_from_positions(pose));
  return learner;
}

TEST(Learner, ColumnsHoldWhatTheBasisMisses) {
  const Asset& asset = *folded_torus().asset;
  std::vector<std::vector<float>> poses;
  for (std::size_t number = 0; number < kPoses; ++number) poses.push_back(torus_pose(number, 1));
  const Learner learner = taught(folded_torus().asset, poses);
  const LearntColumns learnt = learner.columns(eps());
  const std::size_t k = learnt.amplitudes.size();
  ASSERT_GE(k, 2u);
  ASSERT_LE(k, Learner::kMaxColumns);
  for (std::size_t i = 0; i < k; ++i) {
    double norm = 0;
    for (std::size_t row = 0; row < asset.vertex_count; ++row)
      norm += asset.mass[row] * std::pow(learnt.columns.values[row * k + i], 2);
    EXPECT_NEAR(norm, 1, 1e-4);
    EXPECT_LE(learnt.amplitudes[i], learnt.amplitudes[i == 0 ? 0 : i - 1]);
    for (std::uint32_t j = 0; j < asset.rank; ++j) {  // As projections measure: by the roots of masses.
      double with = 0, own = 0, other = 0;
      for (std::size_t row = 0; row < asset.vertex_count; ++row) {
        const double weight = std::sqrt(asset.mass[row]), value = learnt.columns.values[row * k + i];
        with += weight * value * asset.entry(row, j);
        own += weight * value * value;
        other += weight * std::pow(asset.entry(row, j), 2);
      }
      EXPECT_LT(std::abs(with), 0.02 * std::sqrt(own * other)) << i << " " << j;
    }
  }
  const auto encoded = encode_columns(asset, *folded_torus().encoded, learnt.columns);
  ASSERT_TRUE(encoded) << encoded.error().message;
  const auto wider = learnt_asset(asset, *encoded);
  ASSERT_TRUE(wider) << wider.error().message;
  const auto before = Projector::create(asset), after = Projector::create(*wider);
  ASSERT_TRUE(after) << after.error().message;
  const std::vector<float> unseen = torus_pose(kPoses + 7, 1);
  const auto C = before->coefficients_from_positions(unseen), D = after->coefficients_from_positions(unseen);
  EXPECT_LT(3 * rms_error(*wider, unseen, *D), rms_error(asset, unseen, *C));
  // Orthogonal columns leave the others' coefficients as they were, but for rounding.
  double moved = 0;
  for (std::size_t i = 0; i < C->size(); ++i) moved += std::pow((*D)[i] - (*C)[i], 2);
  EXPECT_LT(std::sqrt(moved / asset.area), 0.1 * rms_error(asset, unseen, *C));
}

TEST(Learner, PaysWhereTheBasisMissesMoreThanCodingDoes) {
  std::vector<std::vector<float>> bumpy, smooth;
  for (std::size_t number = 0; number < kPoses; ++number) {
    bumpy.push_back(torus_pose(number, 1));
    smooth.push_back(torus_pose(number, 0, 0.02));
  }
  const auto trial = taught(folded_torus().asset, bumpy).trial(eps(), 30);
  ASSERT_TRUE(trial);
  EXPECT_LT(2 * trial->learnt_error, trial->basis_error);
  EXPECT_LT(trial->equal_kbit_per_s, trial->kbit_per_s);
  ASSERT_TRUE(trial->payback_s(10'000));
  EXPECT_NEAR(*trial->payback_s(20'000), 2 * *trial->payback_s(10'000), 1e-9);
  EXPECT_TRUE(trial->pays(10'000));
  EXPECT_FALSE(trial->pays(1'000'000'000)) << "more than a stay pays back";
  EXPECT_GE(trial->coarser, 1);
  EXPECT_LT(trial->equal_error, std::hypot(trial->basis_error, trial->coding_error)) << "less error of no more bits";
  const Learner learner = taught(folded_torus().asset, smooth);
  EXPECT_TRUE(learner.columns(eps()).amplitudes.empty()) << "finer than coding";
  const auto none = learner.trial(eps(), 30);
  ASSERT_TRUE(none);
  EXPECT_FALSE(none->pays(1));
}

TEST(Learner, KeepsABoundedNumberOfPoses) {
  std::vector<std::vector<float>> poses;
  for (std::size_t number = 0; number < 3 * Learner::kMaxPoses; ++number) poses.push_back(torus_pose(number, 1));
  const Learner learner = taught(folded_torus().asset, poses);
  EXPECT_LE(learner.poses(), Learner::kMaxPoses);
  EXPECT_TRUE(learner.trial(eps(), 30));
  EXPECT_FALSE(taught(folded_torus().asset, {torus_pose(0, 1), torus_pose(1, 1)}).trial(eps(), 30)) << "too few";
}

}  // namespace
}  // namespace eigencast
