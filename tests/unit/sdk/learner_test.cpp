// SPDX-License-Identifier: MIT
#include "sdk/learner.h"

#include <gtest/gtest.h>

#include <cmath>
#include <utility>

#include "common/surface/shapes/shapes.h"
#include "sdk/bake.h"

namespace eigencast {
namespace {

/// A torus in waves, which its basis holds, and bumps, which a few columns hold.
class LearnerTest : public ::testing::Test {
 protected:
  static constexpr std::size_t kPoses = 30;

  static void SetUpTestSuite() {
    rest_ = make_torus(60, 30, 1, 0.4);
    baked_ = std::move(*bake(rest_, {.rank = 30, .name = {}}));
    asset_ = std::make_shared<const Asset>(baked_.asset);
  }
  static void TearDownTestSuite() { asset_.reset(); }

  /// n x 3; both about a tenth of the torus at 1.
  static std::vector<float> pose(std::size_t number, double bumps, double waves = 1) {
    std::vector<float> positions;
    const double t = 0.3 * static_cast<double>(number);
    for (const Vec3& p : rest_.positions) {
      const double around = std::atan2(p[2], p[0]);
      const double bump =
          0.1 * bumps * (std::sin(t) * std::cos(23 * around) + std::cos(1.7 * t) * std::sin(29 * around));
      double wave = 0;
      for (const int m : {1, 2, 3}) wave += 0.1 * waves * std::sin(2.3 * m * m * t + m) * std::cos(m * around);
      for (const double x : {p[0] + wave, p[1] + wave * p[0] + bump, p[2] - wave})
        positions.push_back(static_cast<float>(x));
    }
    return positions;
  }
  static double eps() { return 1e-3 * asset_->diagonal(); }

  static inline Surface rest_;
  static inline BakeResult baked_;
  static inline std::shared_ptr<const Asset> asset_;
};

Learner taught(const std::shared_ptr<const Asset>& asset, const std::vector<std::vector<float>>& poses) {
  const auto projector = Projector::create(*asset);
  Learner learner(asset);
  for (const std::vector<float>& pose : poses) learner.add(pose, *projector->coefficients_from_positions(pose));
  return learner;
}

double rms_error(const Asset& asset, const std::vector<float>& truth, std::span<const double> C) {
  std::vector<float> rows(truth.size());
  positions_from_coefficients(asset, C, 3, asset.rank, asset.vertex_count, rows);
  double squares = 0;
  for (std::size_t row = 0; row < asset.vertex_count; ++row) {
    for (std::size_t d = 0; d < 3; ++d)
      squares += std::pow(truth[3 * asset.source_vertex[row] + d] - asset.origin[d] - rows[3 * row + d], 2);
  }
  return std::sqrt(squares / asset.vertex_count);
}

TEST_F(LearnerTest, ColumnsHoldWhatTheBasisMisses) {
  std::vector<std::vector<float>> poses;
  for (std::size_t number = 0; number < kPoses; ++number) poses.push_back(pose(number, 1));
  const Learner learner = taught(asset_, poses);
  const LearntColumns learnt = learner.columns(eps());
  const std::size_t k = learnt.amplitudes.size();
  ASSERT_GE(k, 2u);
  ASSERT_LE(k, Learner::kMaxColumns);
  for (std::size_t i = 0; i < k; ++i) {
    double norm = 0;
    for (std::size_t row = 0; row < asset_->vertex_count; ++row)
      norm += asset_->mass[row] * std::pow(learnt.columns.values[row * k + i], 2);
    EXPECT_NEAR(norm, 1, 1e-4);
    EXPECT_LE(learnt.amplitudes[i], learnt.amplitudes[i == 0 ? 0 : i - 1]);
    for (std::uint32_t j = 0; j < asset_->rank; ++j) {  // As projections measure: by the roots of masses.
      double with = 0, own = 0, other = 0;
      for (std::size_t row = 0; row < asset_->vertex_count; ++row) {
        const double weight = std::sqrt(asset_->mass[row]), value = learnt.columns.values[row * k + i];
        with += weight * value * asset_->entry(row, j);
        own += weight * value * value;
        other += weight * std::pow(asset_->entry(row, j), 2);
      }
      EXPECT_LT(std::abs(with), 0.02 * std::sqrt(own * other)) << i << " " << j;
    }
  }
  const auto encoded = encode_columns(*asset_, baked_.encoded, learnt.columns);
  ASSERT_TRUE(encoded) << encoded.error().message;
  const auto wider = learnt_asset(*asset_, *encoded);
  ASSERT_TRUE(wider) << wider.error().message;
  const auto before = Projector::create(*asset_), after = Projector::create(*wider);
  ASSERT_TRUE(after) << after.error().message;
  const std::vector<float> unseen = pose(kPoses + 7, 1);
  const auto C = before->coefficients_from_positions(unseen), D = after->coefficients_from_positions(unseen);
  EXPECT_LT(3 * rms_error(*wider, unseen, *D), rms_error(*asset_, unseen, *C));
  // Orthogonal columns leave the others' coefficients as they were, but for rounding.
  double moved = 0;
  for (std::size_t i = 0; i < C->size(); ++i) moved += std::pow((*D)[i] - (*C)[i], 2);
  EXPECT_LT(std::sqrt(moved / asset_->area), 0.1 * rms_error(*asset_, unseen, *C));
}

TEST_F(LearnerTest, PaysWhereTheBasisMissesMoreThanCodingDoes) {
  std::vector<std::vector<float>> bumpy, smooth;
  for (std::size_t number = 0; number < kPoses; ++number) {
    bumpy.push_back(pose(number, 1));
    smooth.push_back(pose(number, 0, 0.02));
  }
  const auto trial = taught(asset_, bumpy).trial(eps(), 30);
  ASSERT_TRUE(trial);
  EXPECT_LT(2 * trial->learnt_error, trial->basis_error);
  EXPECT_LT(trial->equal_kbit_per_s, trial->kbit_per_s);
  ASSERT_TRUE(trial->payback_s(10'000));
  EXPECT_NEAR(*trial->payback_s(20'000), 2 * *trial->payback_s(10'000), 1e-9);
  EXPECT_TRUE(trial->pays(10'000, 3600));
  EXPECT_FALSE(trial->pays(10'000, 0.01)) << "too short a stay";
  const Learner learner = taught(asset_, smooth);
  EXPECT_TRUE(learner.columns(eps()).amplitudes.empty()) << "finer than coding";
  const auto none = learner.trial(eps(), 30);
  ASSERT_TRUE(none);
  EXPECT_FALSE(none->pays(1, 1e9));
}

TEST_F(LearnerTest, KeepsABoundedNumberOfPoses) {
  std::vector<std::vector<float>> poses;
  for (std::size_t number = 0; number < 3 * Learner::kMaxPoses; ++number) poses.push_back(pose(number, 1));
  const Learner learner = taught(asset_, poses);
  EXPECT_LE(learner.poses(), Learner::kMaxPoses);
  EXPECT_TRUE(learner.trial(eps(), 30));
  EXPECT_FALSE(taught(asset_, {pose(0, 1), pose(1, 1)}).trial(eps(), 30)) << "too few";
}

}  // namespace
}  // namespace eigencast
