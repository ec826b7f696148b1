// SPDX-License-Identifier: MIT
#include "sender/deform/arap.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "common/surface/shapes/shapes.h"
#include "common/surface/vector.h"
#include "sdk/bake.h"
#include "sender/deform/deformer.h"
#include "sender/deform/moves.h"

namespace eigencast::deform {
namespace {

/// An upright bar away from zero, held at both ends.
struct Bar {
  Bar() : model(make_box(4, 24, 4, {1, 6, 1})) {
    for (Vec3& p : model.positions) p = {p[0] + 20, p[1] - 5, p[2] + 1};
    BakeOptions options;
    options.rank = 80;
    asset = std::move(bake(model, options)->asset);
    const Box box = bounding_box(model.positions);
    groups.resize(2);
    for (std::uint32_t v = 0; v < model.vertex_count(); ++v) {
      if (model.positions[v][1] < box.low[1] + 0.3) groups[0].push_back(v);
      if (model.positions[v][1] > box.high[1] - 0.3) groups[1].push_back(v);
    }
    deformer = std::move(*reduced_arap_deformer(asset, groups));
  }
  std::vector<Vec3> handles() const { return {deformer->handles().begin(), deformer->handles().end()}; }
  std::vector<Vec3> settled(const std::vector<Vec3>& moved) {
    for (int i = 0; i < 30; ++i) (void)deformer->coefficients(moved);
    return deformer->positions(moved);
  }
  static double rms(const std::vector<Vec3>& a, const std::vector<Vec3>& b) {
    double sum = 0;
    for (std::size_t i = 0; i < a.size(); ++i) sum += dot(a[i] - b[i], a[i] - b[i]);
    return std::sqrt(sum / static_cast<double>(a.size()));
  }
  Surface model;
  Asset asset;
  std::vector<HandleGroup> groups;
  std::unique_ptr<Deformer> deformer;
};

TEST(ReducedArap, RestStaysAtRest) {
  Bar bar;
  EXPECT_LT(Bar::rms(bar.settled(bar.handles()), bar.model.positions), 2e-3);
}

TEST(ReducedArap, ShiftedHandlesShiftTheSurface) {
  Bar bar;
  std::vector<Vec3> moved = bar.handles(), expected = bar.model.positions;
  for (Vec3& p : moved) p = p + Vec3{1, -2, 0.5};
  for (Vec3& p : expected) p = p + Vec3{1, -2, 0.5};
  EXPECT_LT(Bar::rms(bar.settled(moved), expected), 5e-3);
}

TEST(ReducedArap, HandlesReachTheirTargets) {
  Bar bar;
  std::vector<Vec3> moved = bar.handles();
  moved[1] = moved[1] + Vec3{2, -0.5, 0};
  const std::vector<Vec3> pose = bar.settled(moved);
  Vec3 centre{};
  for (const std::uint32_t v : bar.groups[1])
    centre = centre + (1.0 / static_cast<double>(bar.groups[1].size())) * pose[v];
  EXPECT_LT(length(centre - moved[1]), 0.02);
}

TEST(ReducedArap, IsNearTheFullModelsShape) {
  Bar bar;
  auto full = arap_deformer(bar.model, bar.groups, 20);
  ASSERT_TRUE(full);
  std::vector<Vec3> moved = bar.handles();
  moved[1] = moved[1] + Vec3{1.5, -0.4, 0};
  std::vector<Vec3> truth;
  for (int i = 0; i < 40; ++i) truth = (*full)->positions(moved);
  const double movement = Bar::rms(truth, bar.model.positions);
  ASSERT_GT(movement, 0.5);
  EXPECT_LT(Bar::rms(bar.settled(moved), truth), 0.06 * movement);
}

TEST(ReducedArap, WhatIsSentIsThePose) {
  Bar bar;
  const auto projector = Projector::create(bar.asset);
  ASSERT_TRUE(projector);
  auto projected = ProjectedDeformer::create(*bar.deformer, bar.asset, *projector);
  ASSERT_TRUE(projected);
  std::vector<Vec3> moved = bar.handles();
  moved[1] = moved[1] + Vec3{0.7, 0, 0.7};
  (void)bar.settled(moved);
  const auto C = projected->coefficients(moved);
  ASSERT_TRUE(C);
  const std::vector<Vec3> pose = bar.deformer->positions(moved);
  const auto again =
      projector->coefficients_from_positions(std::span<const double>(pose.front().data(), 3 * pose.size()));
  ASSERT_TRUE(again);
  for (std::size_t i = 0; i < C->size(); ++i) EXPECT_NEAR((*C)[i], (*again)[i], 2e-2) << i;
}

TEST(ReducedArap, RefusesUnusableHandles) {
  Bar bar;
  EXPECT_FALSE(reduced_arap_deformer(bar.asset, {}));
  EXPECT_FALSE(reduced_arap_deformer(bar.asset, {{}}));
  for (const std::vector<HandleGroup>& groups :
       std::vector<std::vector<HandleGroup>>{{{bar.asset.vertex_count}}, {{1, 2}, {2}}})
    EXPECT_EQ(reduced_arap_deformer(bar.asset, groups).error().code, ErrorCode::kInvalidArgument);
}

}  // namespace
}  // namespace eigencast::deform
