// SPDX-License-Identifier: MIT
#include "common/spectral/basis.h"

#include <filesystem>

#include "common/spectral/kg_error.h"
#include "common/surface/formats/clip.h"
#include "support.h"
#include "tests/support/paths.h"

namespace eigencast {
namespace {

using testing::orthonormality_defect;
using testing::round_trip;
using testing::uniform;
using testing::worst_error;

constexpr double kRounding = 1e-6;  // what is distinguished, times what adds up over the columns

Vec3 moved_by(const Eigen::Matrix<double, 3, 4>& B, const Vec3& p) {
  const Eigen::Vector3d q = B * Eigen::Vector4d(p[0], p[1], p[2], 1);
  return {q[0], q[1], q[2]};
}

Eigen::Matrix<double, 3, 4> random_map(std::mt19937& generator) {
  return Eigen::Matrix<double, 3, 4>::NullaryExpr([&] { return 2 * uniform(generator) - 1; });
}

/// A torus on three bones, blended along x, the third carrying nothing; one morph target lifts a corner of it.
struct Rigged {
  Surface rest = make_torus(24, 12, 1.0, 0.4);
  Rig rig;

  Rigged() {
    rig.bones = {"root", "tip", "unused"};
    rig.bind = rest.positions;
    rig.first_influence = {0};
    for (const Vec3& p : rest.positions) {
      const double t = std::clamp(p[0] + 0.5, 0.0, 1.0);
      if (t < 1) rig.influences.push_back({0, 1 - t});
      if (t > 0) rig.influences.push_back({1, t});
      rig.first_influence.push_back(static_cast<std::uint32_t>(rig.influences.size()));
    }
    Rig::MorphTarget lift{"lift", {}, {}};
    for (std::uint32_t i = 0; i < rest.positions.size(); ++i) {
      const Vec3& p = rest.positions[i];
      if (p[0] < 0.9) continue;
      lift.vertices.push_back(i);
      lift.offsets.push_back({0.1 * p[1] * p[1], std::sin(5 * p[2]), p[0] * p[2]});
    }
    rig.targets.push_back(lift);
  }

  /// Any pose of the rig: arbitrary bones and target weights.
  std::vector<Vec3> pose(std::mt19937& generator) const {
    std::vector<Vec3> morphed = rig.bind;
    const double amount = 3 * uniform(generator);
    for (std::size_t k = 0; k < rig.targets[0].vertices.size(); ++k) {
      for (std::size_t c = 0; c < 3; ++c)
        morphed[rig.targets[0].vertices[k]][c] += amount * rig.targets[0].offsets[k][c];
    }
    const std::vector<Eigen::Matrix<double, 3, 4>> bones{random_map(generator), random_map(generator)};
    std::vector<Vec3> result;
    for (std::size_t i = 0; i < morphed.size(); ++i) {
      Vec3 sum{};
      for (std::uint32_t k = rig.first_influence[i]; k < rig.first_influence[i + 1]; ++k) {
        const Vec3 at = moved_by(bones[rig.influences[k].bone], morphed[i]);
        for (std::size_t c = 0; c < 3; ++c) sum[c] += rig.influences[k].weight * at[c];
      }
      result.push_back(sum);
    }
    return result;
  }
};

Basis motion_basis_of(const Surface& rest, const KnownMotion& motion, int rank) {
  const auto laplacian = build_laplacian(rest);
  EXPECT_TRUE(laplacian);
  auto basis = build_motion_basis(rest, *laplacian, motion, rank);
  EXPECT_TRUE(basis) << basis.error().message;
  EXPECT_LE(orthonormality_defect(basis->Psi, laplacian->mass), 1e-10);
  return std::move(*basis);
}

KnownMotion motion_from(SpanningColumns columns, const std::vector<std::vector<Vec3>>& poses) {
  return {std::move(columns), poses.size(), [&poses](std::size_t i) -> Result<std::vector<Vec3>> { return poses[i]; }};
}

double kg_of_prefix(const Basis& basis, Eigen::Index rank, const std::vector<std::vector<Vec3>>& poses) {
  Basis prefix = basis;
  prefix.Psi.conservativeResize(Eigen::NoChange, rank);
  KgError error;
  for (const auto& pose : poses) error.add_frame(pose, round_trip(prefix, pose));
  return error.percent();
}

TEST(RigColumns, CoverUsedBonesAndTheirTargets) {
  const Rigged rigged;
  const auto columns = columns_from_rig(rigged.rig);
  ASSERT_TRUE(columns);
  EXPECT_EQ(columns->count, 2u * 4 + 3) << "the third bone carries nothing, the target lies on the second alone";
  EXPECT_EQ(columns->W.size(), rigged.rest.vertex_count() * columns->count);
}

TEST(RigColumns, ThatAreTooManyAreRefused) {
  Rig rig;
  rig.bind = make_torus(40, 20, 1.0, 0.4).positions;
  rig.first_influence = {0};
  for (std::uint32_t i = 0; i < rig.bind.size(); ++i) {
    rig.bones.push_back("b");
    rig.influences.push_back({i, 1});
    rig.first_influence.push_back(i + 1);
  }
  const auto columns = columns_from_rig(rig);
  ASSERT_FALSE(columns);
  EXPECT_EQ(columns.error().code, ErrorCode::kTooLarge);
  EXPECT_NE(columns.error().message.find("3200"), std::string::npos) << columns.error().message;
}

// The theorem: the span holds every pose of the rig, not only the sampled ones.
TEST(MotionBasis, OfARigHoldsEveryPoseExactly) {
  const Rigged rigged;
  std::mt19937 generator(1);
  const std::vector<std::vector<Vec3>> seen{rigged.rest.positions, rigged.pose(generator), rigged.pose(generator)};
  const Basis basis = motion_basis_of(rigged.rest, motion_from(*columns_from_rig(rigged.rig), seen), 100);
  EXPECT_LE(basis.Psi.cols(), 11);
  EXPECT_EQ(basis.dimensions, basis.Psi.cols());
  for (int i = 0; i < 20; ++i) {
    const auto pose = rigged.pose(generator);
    EXPECT_LE(worst_error(pose, round_trip(basis, pose)), kRounding);
  }
  EXPECT_LE(basis.left_out, kRounding);
}

TEST(MotionBasis, BeginsWithTheConstantAndTheRestPose) {
  const Rigged rigged;
  const Basis basis = motion_basis_of(rigged.rest, motion_from(*columns_from_rig(rigged.rig), {}), 100);
  const Eigen::VectorXd first = basis.Psi.col(0);
  EXPECT_LE((first.array() - first[0]).abs().maxCoeff(), 1e-12 * std::abs(first[0]));
  Basis prefix = basis;
  prefix.Psi.conservativeResize(Eigen::NoChange, 4);
  const auto image = testing::affine_image(rigged.rest.positions);
  EXPECT_LE(worst_error(image, round_trip(prefix, image)), 1e-12);
  EXPECT_EQ(basis.rms.size(), 0) << "no poses are known";
}

TEST(MotionBasis, PrefixesImproveUpToTheRank) {
  const Rigged rigged;
  std::mt19937 generator(2);
  std::vector<std::vector<Vec3>> poses;
  for (int i = 0; i < 30; ++i) poses.push_back(rigged.pose(generator));
  const KnownMotion motion = motion_from(*columns_from_rig(rigged.rig), poses);
  const Basis basis = motion_basis_of(rigged.rest, motion, 100);
  for (Eigen::Index k = 4; k < basis.Psi.cols(); ++k) {
    EXPECT_LE(kg_of_prefix(basis, k + 1, poses), kg_of_prefix(basis, k, poses));
    if (k > 4) {
      EXPECT_LE(basis.rms[k], basis.rms[k - 1]);
    }
  }
  const Basis shorter = motion_basis_of(rigged.rest, motion, 7);
  EXPECT_EQ(shorter.Psi.cols(), 7);
  EXPECT_EQ(shorter.dimensions, basis.dimensions);
  EXPECT_NEAR(kg_of_prefix(shorter, 7, poses), kg_of_prefix(basis, 7, poses), 1e-9);
  EXPECT_NEAR(100 * shorter.left_out, kg_of_prefix(shorter, 7, poses), 0.2 * 100 * shorter.left_out);
}

// One column is dependent, one nearly dependent, one lives on a few small vertices: the last must stay.
TEST(MotionBasis, DropsDependentColumnsAndKeepsSmallOnes) {
  const Surface rest = make_icosphere(3);
  const std::size_t n = rest.vertex_count();
  SpanningColumns columns{4, std::vector<double>(n * 4)};
  for (std::size_t i = 0; i < n; ++i) {
    const double wave = std::sin(3 * rest.positions[i][0]);
    columns.W[4 * i] = wave;
    columns.W[4 * i + 1] = 2 * wave + rest.positions[i][1] - 7;
    columns.W[4 * i + 2] = wave * (1 + 1e-9 * rest.positions[i][2]);
    columns.W[4 * i + 3] = i < 3 ? 1e-4 * static_cast<double>(i + 1) : 0;
  }
  const Basis basis = motion_basis_of(rest, motion_from(columns, {}), 100);
  EXPECT_EQ(basis.Psi.cols(), 6);
  std::vector<Vec3> pose = rest.positions;
  for (std::size_t i = 0; i < 3; ++i) pose[i][2] += 0.5 * static_cast<double>(i + 1);
  EXPECT_LE(worst_error(pose, round_trip(basis, pose)), kRounding);
}

TEST(MotionBasis, LearnedBasisNeedsOnlyTheMotionsDimensions) {
  const Rigged rigged;
  std::mt19937 generator(3);
  std::vector<std::vector<Vec3>> poses;
  for (int i = 0; i < 120; ++i) poses.push_back(rigged.pose(generator));  // More than are taken in at a time.
  const Basis all = motion_basis_of(rigged.rest, motion_from({}, poses), 100);
  EXPECT_LE(all.Psi.cols(), 11) << "a rig of eleven columns made them";
  EXPECT_LE(kg_of_prefix(all, all.Psi.cols(), poses), 1e-4);
  // The best of its length: none is better than the same prefix of what the rig's own columns give, ordered by all
  // poses.
  const Basis spanned = motion_basis_of(rigged.rest, motion_from(*columns_from_rig(rigged.rig), poses), 100);
  for (const Eigen::Index r : {5, 6, 8}) {
    EXPECT_NEAR(kg_of_prefix(motion_basis_of(rigged.rest, motion_from({}, poses), static_cast<int>(r)), r, poses),
                kg_of_prefix(spanned, r, poses), 1e-3 * kg_of_prefix(spanned, r, poses));
  }
}

TEST(MotionBasis, RefusesWhatItCannotUse) {
  const Surface rest = make_icosphere(2);
  const auto laplacian = build_laplacian(rest);
  const std::vector<std::vector<Vec3>> one{rest.positions};
  EXPECT_EQ(build_motion_basis(rest, *laplacian, motion_from({}, one), 10).error().code, ErrorCode::kInvalidArgument);
  const std::vector<std::vector<Vec3>> uneven{rest.positions, {rest.positions.begin(), rest.positions.end() - 1}};
  const auto refused = build_motion_basis(rest, *laplacian, motion_from({}, uneven), 10);
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.error().message.find("pose 1"), std::string::npos) << refused.error().message;
  EXPECT_FALSE(build_motion_basis(rest, *laplacian, motion_from({2, {1, 2, 3}}, {}), 10));
  const std::vector<std::vector<Vec3>> broken{rest.positions, std::vector<Vec3>(rest.vertex_count(), {0, NAN, 0})};
  EXPECT_EQ(build_motion_basis(rest, *laplacian, motion_from({}, broken), 10).error().code,
            ErrorCode::kInvalidArgument);
  const std::vector<std::vector<Vec3>> still(3, rest.positions);
  const Progress stop = [](double, std::string_view) { return false; };
  EXPECT_EQ(build_motion_basis(rest, *laplacian, motion_from({}, still), 10, stop).error().code, ErrorCode::kCancelled);
  const auto basis = build_motion_basis(rest, *laplacian, motion_from({}, still), 10);
  ASSERT_TRUE(basis) << "a clip that stands still needs its rest pose only";
  EXPECT_EQ(basis->Psi.cols(), 4);
}

// A surface of few vertices has room for few columns.
TEST(MotionBasis, NeverHasMoreColumnsThanVertices) {
  const Surface rest = make_icosphere(0);
  SpanningColumns columns{20, std::vector<double>(20 * rest.vertex_count())};
  std::mt19937 generator(4);
  for (double& value : columns.W) value = uniform(generator);
  EXPECT_EQ(motion_basis_of(rest, motion_from(columns, {}), 100).Psi.cols(),
            static_cast<Eigen::Index>(rest.vertex_count()));
}

TEST(MotionBasis, LearnedBasisBeatsOthersTenfoldOnTheHorse) {
  EIGENCAST_SKIP_WITHOUT("animations/horse-gallop");
  const auto clip = open_clip(gait_clip().string());
  ASSERT_TRUE(clip);
  const KnownMotion motion{{}, (*clip)->frame_count(), [&](std::size_t i) { return (*clip)->pose(i); }};
  const Basis basis = motion_basis_of((*clip)->rest(), motion, 50);
  EXPECT_EQ(basis.Psi.cols(), 50);
  KgError error;
  for (std::size_t i = 0; i < (*clip)->frame_count(); ++i) {
    const auto pose = (*clip)->pose(i);
    ASSERT_TRUE(pose);
    error.add_frame(*pose, round_trip(basis, *pose));
  }
  EXPECT_LT(error.percent(), 0.1);
  EXPECT_GT(error.percent(), 0.09);
}

TEST(MotionBasis, OfASkinnedFileHoldsItsClips) {
  for (const auto& [file, animation] : {std::pair{rigged_file(), "Walk"}, {morphing_file(), ""}}) {
    const auto clip = open_clip(file.string(), {.animation = animation});
    ASSERT_TRUE(clip) << clip.error().message;
    const KnownMotion motion{*columns_from_rig(*(*clip)->rig()), (*clip)->frame_count(),
                             [&](std::size_t i) { return (*clip)->pose(i); }};
    const Basis basis = motion_basis_of((*clip)->rest(), motion, 4096);
    EXPECT_LE(basis.Psi.cols(), 96) << file;
    // Whatever animation of the file it is: the basis is the rig's.
    const auto other = open_clip(file.string(), {.animation = *animation ? "Run" : ""});
    ASSERT_TRUE(other);
    for (std::size_t i = 0; i < (*other)->frame_count(); ++i) {
      const auto pose = (*other)->pose(i);
      ASSERT_TRUE(pose);
      EXPECT_LE(worst_error(*pose, round_trip(basis, *pose)), kRounding) << file << ", frame " << i;
    }
  }
}

}  // namespace
}  // namespace eigencast
