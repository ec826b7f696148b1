// SPDX-License-Identifier: MIT
#include "sender/deform/cage.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "common/surface/checks/check.h"
#include "common/surface/formats/read.h"
#include "common/surface/shapes/shapes.h"
#include "common/surface/vector.h"
#include "tests/support/paths.h"

namespace eigencast::deform {
namespace {

/// Distance from a point to a triangle (Ericson, "Real-Time Collision Detection", 2005, 5.1.5, by its regions).
double distance_to(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c) {
  const auto to_segment = [&](const Vec3& s, const Vec3& e) {
    const Vec3 d = e - s;
    return length(s + std::clamp(dot(p - s, d) / dot(d, d), 0.0, 1.0) * d - p);
  };
  const Vec3 n = unit(cross(b - a, c - a));
  const Vec3 foot = p - dot(p - a, n) * n;
  const bool within =
      dot(cross(b - a, foot - a), n) >= 0 && dot(cross(c - b, foot - b), n) >= 0 && dot(cross(a - c, foot - c), n) >= 0;
  return within ? length(foot - p) : std::min({to_segment(a, b), to_segment(b, c), to_segment(c, a)});
}

void expect_strictly_inside(const Surface& model, int resolution) {
  const auto cage = cage_around(model, resolution);
  ASSERT_TRUE(cage.has_value()) << cage.error().message;
  const SurfaceReport report = check_surface(*cage);
  EXPECT_TRUE(report.closed());
  EXPECT_EQ(report.misoriented_edges, 0u);
  EXPECT_EQ(report.nonmanifold_vertices, 0u);
  EXPECT_EQ(report.degenerate_faces, 0u);
  const Box box = bounding_box(model.positions);
  double side = 0;
  for (std::size_t c = 0; c < 3; ++c) side = std::max(side, (box.high[c] - box.low[c]) / resolution);
  for (std::size_t i = 0; i < model.vertex_count(); i += 7) {
    const Vec3& p = model.positions[i];
    EXPECT_NEAR(winding_number(*cage, p), 1, 1e-9) << "vertex " << i;
    for (const Face& f : cage->faces) {
      ASSERT_GE(distance_to(p, cage->positions[f[0]], cage->positions[f[1]], cage->positions[f[2]]), 0.5 * side);
    }
  }
  // Taken as it is by what reads cages from files.
  const auto again = cage_from_mesh(*cage);
  ASSERT_TRUE(again.has_value()) << again.error().message;
  EXPECT_EQ(again->faces, cage->faces) << "already outward";
}

TEST(AutomaticCage, EnclosesTheModelAtAnyResolution) {
  for (const int resolution : {1, 2, 3, 5, 9}) {
    expect_strictly_inside(make_heart(9), resolution);
    expect_strictly_inside(make_torus(40, 16, 1, 0.2), resolution);
    expect_strictly_inside(make_box(1, 1, 1, {1, 4, 0.01}), resolution);
  }
}

TEST(AutomaticCage, EnclosesPointsAndDefectiveMeshes) {
  Surface cloud;
  for (int i = 0; i < 100; ++i) cloud.positions.push_back({std::cos(0.3 * i), 0.05 * i, std::sin(0.3 * i)});
  expect_strictly_inside(cloud, 12);
  for (const char* folder : {"meshes/clean", "meshes/nasty"}) {
    for (const auto& entry : std::filesystem::directory_iterator(data_dir() / folder)) {
      const auto model = read_surface(entry.path().string());
      ASSERT_TRUE(model.has_value());
      if (model->vertex_count() < 5000) expect_strictly_inside(*model, 8);
    }
  }
}

TEST(AutomaticCage, RefusesEmptyExtentAndBadResolution) {
  EXPECT_FALSE(cage_around({{{1, 1, 1}, {1, 1, 1}}, {}}, 4).has_value());
  EXPECT_FALSE(cage_around(make_icosphere(1), 0).has_value());
  EXPECT_FALSE(cage_around(make_icosphere(1), 65).has_value());
}

TEST(Cage, FromMeshIsClosedAndFacesOutward) {
  Surface inside_out = make_icosphere(1);
  for (Face& f : inside_out.faces) std::swap(f[1], f[2]);
  const auto turned = cage_from_mesh(inside_out);
  ASSERT_TRUE(turned.has_value());
  EXPECT_EQ(turned->faces, make_icosphere(1).faces);

  Surface open = make_icosphere(1);
  open.faces.pop_back();
  EXPECT_EQ(cage_from_mesh(open).error().code, ErrorCode::kInvalidArgument);
  Surface mixed = make_icosphere(1);
  std::swap(mixed.faces[0][1], mixed.faces[0][2]);
  EXPECT_EQ(cage_from_mesh(mixed).error().code, ErrorCode::kInvalidArgument);
}

TEST(CageDeformer, RefusesModelOutsideTheCage) {
  Surface model = make_icosphere(2);
  const auto out = cage_deformer(model, make_box(1, 1, 1, {1.5, 3, 3}), CageCoordinates::kGreen);
  ASSERT_FALSE(out.has_value());
  EXPECT_EQ(out.error().code, ErrorCode::kInvalidArgument);
  EXPECT_TRUE(cage_deformer(model, make_box(1, 1, 1, {1.5, 3, 3}), CageCoordinates::kMeanValue).has_value());
  EXPECT_TRUE(cage_deformer(model, make_box(1, 1, 1, {3, 3, 3}), CageCoordinates::kGreen).has_value());
}

}  // namespace
}  // namespace eigencast::deform
