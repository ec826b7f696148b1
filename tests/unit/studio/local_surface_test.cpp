// SPDX-License-Identifier: MIT
#include "sender/studio/local_surface.h"

#include <gtest/gtest.h>

#include <cmath>

#include "common/surface/shapes/shapes.h"
#include "sdk/bake.h"
#include "sender/deform/cage.h"
#include "sender/deform/deformer.h"
#include "sender/deform/moves.h"

namespace eigencast::studio {
namespace {

/// A sphere away from zero, in its cage, on few coefficients.
struct Bench {
  Bench() {
    for (Vec3& p : model.positions) p = {p[0] + 40, p[1] - 7, p[2] + 3};
    BakeOptions options;
    options.rank = 24;
    asset = std::move(bake(model, options)->asset);
    auto cage = deform::cage_around(model, 4);
    deformer = *deform::cage_deformer(model, std::move(*cage), deform::CageCoordinates::kGreen);
  }
  std::vector<Vec3> twisted(double angle) const {
    const auto handles = deformer->handles();
    const Box box = bounding_box(handles);
    std::vector<Vec3> moved;
    for (const Vec3& p : handles) moved.push_back(deform::twisted(p, box, {1, 0}, angle));
    return moved;
  }
  std::vector<Vec3> in_asset_space(std::vector<Vec3> points) const {
    for (Vec3& p : points) {
      for (std::size_t k = 0; k < 3; ++k) p[k] -= asset.origin[k];
    }
    return points;
  }
  Surface model = make_icosphere(3);
  Asset asset;
  std::unique_ptr<deform::Deformer> deformer;
};

TEST(LocalSurface, MeasuresErrorOfSentPose) {
  Bench b;
  const auto projector = Projector::create(b.asset);
  ASSERT_TRUE(projector);
  auto projected = deform::ProjectedDeformer::create(*b.deformer, b.asset, *projector);
  ASSERT_TRUE(projected);
  LocalSurface local(b.asset, b.deformer->linear_map());
  for (const double angle : {0.0, 2.0}) {
    const std::vector<Vec3> moved = b.twisted(angle);
    const auto C = projected->coefficients(moved);
    ASSERT_TRUE(C);
    local.set(b.deformer->controls(b.in_asset_space(moved)), *C);
    const std::vector<Vec3> truth = b.in_asset_space(b.deformer->positions(moved));
    std::vector<float> received(3 * truth.size());
    positions_from_coefficients(b.asset, *C, 3, b.asset.rank, b.asset.vertex_count, received);
    double sum = 0, most = 0;
    for (std::size_t row = 0; row < truth.size(); ++row) {
      const Vec3& p = truth[b.asset.source_vertex[row]];
      double squared = 0;
      for (std::size_t k = 0; k < 3; ++k) {
        EXPECT_NEAR(static_cast<double>(local.geometry().positions[3 * row + k]), p[k], 1e-5) << row;
        squared += std::pow(p[k] - static_cast<double>(received[3 * row + k]), 2);
      }
      sum += squared;
      most = std::max(most, squared);
    }
    const double diagonal = b.asset.diagonal();
    EXPECT_NEAR(local.rms(), std::sqrt(sum / static_cast<double>(truth.size())) / diagonal, 1e-6);
    EXPECT_NEAR(local.max(), std::sqrt(most) / diagonal, 1e-6);
    if (angle > 0) {
      EXPECT_GT(local.rms(), 1e-4) << "a twisted sphere is more than 24 coefficients hold";
    }
  }
}

TEST(LocalSurface, ShowsWhatViewersGetWhenAsked) {
  Bench b;
  const auto projector = Projector::create(b.asset);
  auto projected = deform::ProjectedDeformer::create(*b.deformer, b.asset, *projector);
  LocalSurface local(b.asset, b.deformer->linear_map());
  const std::vector<Vec3> moved = b.twisted(1.5);
  const auto C = projected->coefficients(moved);
  local.show_received(true);
  local.set(b.deformer->controls(b.in_asset_space(moved)), *C);
  std::vector<float> received(std::size_t{3} * b.asset.vertex_count);
  positions_from_coefficients(b.asset, *C, 3, b.asset.rank, b.asset.vertex_count, received);
  for (std::size_t i = 0; i < received.size(); ++i) ASSERT_NEAR(local.geometry().positions[i], received[i], 1e-5F);
  EXPECT_EQ(local.geometry().normals.size(), received.size());
}

TEST(LocalSurface, WithoutLinearMapShowsTheSentPose) {
  Bench b;
  LocalSurface local(b.asset, nullptr);
  EXPECT_TRUE(local.received_shown());
  local.set({}, b.asset.rest);
  EXPECT_EQ(local.rms(), 0);
  EXPECT_EQ(local.geometry().vertex_count(), b.asset.vertex_count);
}

}  // namespace
}  // namespace eigencast::studio
