// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include <filesystem>

#include "common/spectral/kg_error.h"
#include "common/surface/formats/clip.h"
#include "common/surface/formats/read.h"
#include "support.h"
#include "tests/support/paths.h"

namespace eigencast {
namespace {

namespace fs = std::filesystem;

const fs::path kData = data_dir();

std::unique_ptr<MotionClip> gait() {
  auto clip = open_clip(gait_clip().string());
  EXPECT_TRUE(clip) << clip.error().message;
  return std::move(*clip);
}

// Regression anchors of horse-gallop, or of the clip that stands in.
struct Anchors {
  double augmented_percent, harmonic_percent, max_points_percent;
};
Anchors anchors() {
  return has_data("animations/horse-gallop") ? Anchors{0.945, 2.15, 1.2} : Anchors{0.391, 1.301, 1.2};
}

double kg_percent(const MotionClip& clip, const Basis& basis) {
  KgError error;
  for (std::size_t i = 0; i < clip.frame_count(); ++i) {
    const auto pose = clip.pose(i);
    EXPECT_TRUE(pose);
    error.add_frame(*pose, testing::round_trip(basis, *pose));
  }
  return error.percent();
}

TEST(RealData, TheSpectrumFollowsWeyl) {
  const auto clip = gait();
  const auto laplacian = build_laplacian(clip->rest());
  ASSERT_TRUE(laplacian);
  const auto basis = solve_eigenbasis(*laplacian, 200);
  ASSERT_TRUE(basis) << basis.error().message;
  EXPECT_TRUE(basis->certified);
  EXPECT_LE(basis->residual, 1e-8);
  EXPECT_LE(testing::orthonormality_defect(basis->Phi, laplacian->mass), 1e-10);
  const double weyl = 4 * M_PI * 200 / laplacian->area;
  EXPECT_NEAR(basis->eigenvalues[199], weyl, 0.15 * weyl);
  if (!has_data("animations/horse-gallop")) return;
  EXPECT_NEAR(basis->eigenvalues[1], 2.206223, 1e-5);
  EXPECT_NEAR(basis->eigenvalues[199], 851.324, 1e-2);
}

TEST(RealData, TheErrorAtRank200IsUnchanged) {
  const auto clip = gait();
  const auto laplacian = build_laplacian(clip->rest());
  ASSERT_TRUE(laplacian);
  const auto augmented = build_basis(clip->rest(), *laplacian, {BasisKind::kAugmented, 200});
  ASSERT_TRUE(augmented);
  EXPECT_LE(testing::worst_error(clip->rest().positions, testing::round_trip(*augmented, clip->rest().positions)),
            1e-12);
  const double error = kg_percent(*clip, *augmented);
  EXPECT_NEAR(error, anchors().augmented_percent, 0.01);  // Ten groups of products.
  const auto harmonic = build_basis(clip->rest(), *laplacian, {BasisKind::kHarmonic, 200});
  ASSERT_TRUE(harmonic);
  EXPECT_NEAR(kg_percent(*clip, *harmonic), anchors().harmonic_percent, 0.05);
}

TEST(RealData, VerticesAsPointsAreAboutAsGood) {
  const auto clip = gait();
  Surface cloud = clip->rest();
  cloud.faces.clear();
  const auto laplacian = build_laplacian(cloud);
  ASSERT_TRUE(laplacian);
  EXPECT_EQ(laplacian->components, 1);
  const auto augmented = build_basis(cloud, *laplacian, {BasisKind::kAugmented, 200});
  ASSERT_TRUE(augmented);
  EXPECT_LT(kg_percent(*clip, *augmented), anchors().max_points_percent);
}

TEST(RealData, ComponentsAreBridged) {
  const bool real = has_data("meshes/nasty/cgal_bones.off");
  const int parts = real ? 26 : 3;
  const auto bones = read_surface((kData / "meshes/nasty" / (real ? "cgal_bones.off" : "herd.obj")).string());
  ASSERT_TRUE(bones);
  const auto apart = build_laplacian(*bones, {.bridge = false});
  ASSERT_TRUE(apart);
  EXPECT_EQ(apart->components, parts);
  const auto kernel = solve_eigenbasis(*apart, 40);
  ASSERT_TRUE(kernel) << kernel.error().message;
  EXPECT_EQ((kernel->eigenvalues.array() <= 0).count(), parts);
  const auto joined = build_laplacian(*bones);
  ASSERT_TRUE(joined);
  const auto basis = solve_eigenbasis(*joined, 40);
  ASSERT_TRUE(basis);
  EXPECT_EQ((basis->eigenvalues.array() <= 0).count(), 1);
}

TEST(RealData, OddMeshesGiveABasisOrAReason) {
  std::size_t files = 0;
  for (const char* folder : {"meshes/nasty", "clouds"}) {
    for (const auto& entry : fs::directory_iterator(kData / folder)) {
      const auto surface = read_surface(entry.path().string());
      if (!surface) continue;
      ++files;
      const auto laplacian = build_laplacian(*surface);
      if (!laplacian) {
        EXPECT_FALSE(laplacian.error().message.empty());
        continue;
      }
      const auto basis = build_basis(*surface, *laplacian, {BasisKind::kAugmented, 40});
      ASSERT_TRUE(basis) << entry.path() << ": " << basis.error().message;
      EXPECT_TRUE(basis->certified) << entry.path();
      EXPECT_LE(testing::orthonormality_defect(basis->Psi, basis->mass), 1e-10) << entry.path();
      EXPECT_LE(testing::worst_error(surface->positions, testing::round_trip(*basis, surface->positions)), 1e-11)
          << entry.path();
    }
  }
  EXPECT_GE(files, 6U);
}

}  // namespace
}  // namespace eigencast
