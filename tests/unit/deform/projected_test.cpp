// SPDX-License-Identifier: MIT
#include "sender/deform/deformer.h"

#include <gtest/gtest.h>

#include <cmath>

#include "common/surface/shapes/shapes.h"
#include "sdk/bake.h"
#include "sender/deform/cage.h"
#include "sender/deform/script.h"

namespace eigencast::deform {
namespace {

// The theorem behind the fast path: projecting W y is L W times y, whatever the pose; here to the rounding of the
// projector, which sums floats.
void expect_same_coefficients(CageCoordinates coordinates, const Vec3& origin) {
  Surface model = make_heart(9);
  for (Vec3& p : model.positions) {
    for (std::size_t c = 0; c < 3; ++c) p[c] += origin[c];
  }
  const auto baked = bake(model, {BasisKind::kAugmented, 40, "heart"});
  ASSERT_TRUE(baked.has_value()) << baked.error().message;
  const auto projector = Projector::create(baked->asset);
  ASSERT_TRUE(projector.has_value());
  auto cage = cage_around(model, 4);
  ASSERT_TRUE(cage.has_value());
  const auto deformer = cage_deformer(model, *cage, coordinates);
  ASSERT_TRUE(deformer.has_value()) << deformer.error().message;
  auto projected = ProjectedDeformer::create(**deformer, baked->asset, *projector);
  ASSERT_TRUE(projected.has_value());
  const auto script = Script::builtin("both", (*deformer)->handles());
  ASSERT_TRUE(script.has_value());
  for (const double time_s : {0.0, 0.4, 1.0, 2.7}) {
    const std::vector<Vec3> moved = script->handles_at(time_s);
    const std::vector<Vec3> positions = (*deformer)->positions(moved);
    const auto slow =
        projector->coefficients_from_positions(std::span<const double>(positions.front().data(), 3 * positions.size()));
    const auto fast = projected->coefficients(moved);
    ASSERT_TRUE(slow && fast);
    double largest = 0;
    for (const double value : *slow) largest = std::max(largest, std::abs(value));
    for (std::size_t i = 0; i < slow->size(); ++i) EXPECT_NEAR((*fast)[i], (*slow)[i], 2e-6 * largest) << i;
  }
  std::vector<Vec3> broken((*deformer)->handles().begin(), (*deformer)->handles().end());
  broken[3][1] = std::nan("");
  EXPECT_FALSE(projected->coefficients(broken).has_value());
}

TEST(ProjectedDeformer, EqualsTransformOfTheDeformedSurface) {
  expect_same_coefficients(CageCoordinates::kGreen, {0, 0, 0});
  expect_same_coefficients(CageCoordinates::kGreen, {5, -3, 2});
  expect_same_coefficients(CageCoordinates::kMeanValue, {5, -3, 2});
}

TEST(ProjectedDeformer, RefusesAnAssetOfAnotherSurface) {
  const auto baked = bake(make_icosphere(2), {BasisKind::kHarmonic, 10, "sphere"});
  ASSERT_TRUE(baked.has_value());
  const auto projector = Projector::create(baked->asset);
  const Surface other = make_icosphere(1);
  const auto deformer = cage_deformer(other, *cage_around(other, 2), CageCoordinates::kGreen);
  ASSERT_TRUE(projector && deformer);
  EXPECT_FALSE(ProjectedDeformer::create(**deformer, baked->asset, *projector).has_value());
}

}  // namespace
}  // namespace eigencast::deform
