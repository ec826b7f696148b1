// SPDX-License-Identifier: MIT
#include "common/surface/checks/check.h"

#include <gtest/gtest.h>

#include <cmath>

#include "common/surface/shapes/shapes.h"

namespace eigencast {
namespace {

const Surface kTetrahedron{{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, {{0, 2, 1}, {0, 1, 3}, {1, 2, 3}, {0, 3, 2}}};

TEST(CheckSurface, ClosedSurfaceHasNoFaults) {
  const SurfaceReport r = check_surface(kTetrahedron);
  EXPECT_TRUE(r.closed());
  EXPECT_EQ(r.components, 1u);
  EXPECT_EQ(text_from_report(r), "4 vertices, 4 faces, 1 component, closed\n");
}

TEST(CheckSurface, MissingFaceLeavesOneLoopOfThreeEdges) {
  Surface s = make_icosphere(1);
  s.faces.erase(s.faces.begin() + 10);
  const SurfaceReport r = check_surface(s);
  EXPECT_EQ(r.boundary_edges, 3u);
  EXPECT_EQ(r.boundary_loops, 1u);
  EXPECT_FALSE(r.closed());
  EXPECT_EQ(r.nonmanifold_vertices, 0u);
}

TEST(CheckSurface, SurfacesThatTouchInAVertex) {
  Surface s = kTetrahedron;
  for (const Vec3& p : {Vec3{-1, 0, 0}, Vec3{0, -1, 0}, Vec3{0, 0, -1}}) s.positions.push_back(p);
  for (const Face& f : {Face{0, 5, 4}, Face{0, 4, 6}, Face{4, 5, 6}, Face{0, 6, 5}}) s.faces.push_back(f);
  const SurfaceReport r = check_surface(s);
  EXPECT_EQ(r.nonmanifold_vertices, 1u);
  EXPECT_EQ(r.components, 1u);
  EXPECT_TRUE(r.closed());
}

TEST(CheckSurface, HolesThatTouchInAVertexAreOneLoop) {
  // Two holes share a vertex of a flat grid: its faces form two fans.
  Surface s = make_box(6, 6, 1, {6, 6, 1});
  const auto centre = [&](const Face& f, std::size_t c) {
    return (s.positions[f[0]][c] + s.positions[f[1]][c] + s.positions[f[2]][c]) / 3;
  };
  std::erase_if(s.faces, [&](const Face& f) {
    const double x = centre(f, 0);
    const double y = centre(f, 1);
    const bool one = x > 0 && x < 1 && y > 0 && y < 1;
    const bool other = x < 0 && x > -1 && y < 0 && y > -1;
    return centre(f, 2) > 0.49 && (one || other);
  });
  const SurfaceReport r = check_surface(s);
  EXPECT_EQ(r.boundary_edges, 8u);
  EXPECT_EQ(r.boundary_loops, 1u);
  EXPECT_EQ(r.nonmanifold_vertices, 1u);
}

TEST(CheckSurface, ThreeFacesOnAnEdge) {
  const Surface s{{{0, 0, 0}, {0, 0, 1}, {1, 0, 0}, {0, 1, 0}, {-1, 0, 0}}, {{0, 1, 2}, {0, 1, 3}, {1, 0, 4}}};
  const SurfaceReport r = check_surface(s);
  EXPECT_EQ(r.nonmanifold_edges, 1u);
  EXPECT_EQ(r.boundary_edges, 6u);
  EXPECT_EQ(r.nonmanifold_vertices, 0u);
}

TEST(CheckSurface, FlippedFaceMisorientsItsThreeEdges) {
  Surface s = make_icosphere(2);
  std::swap(s.faces[7][0], s.faces[7][1]);
  EXPECT_EQ(check_surface(s).misoriented_edges, 3u);
}

TEST(CheckSurface, LoopsDoNotDependOnOrientation) {
  Surface s = make_torus(12, 8, 1, 0.4);
  s.faces.erase(s.faces.begin() + 100);
  s.faces.erase(s.faces.begin() + 3);
  for (std::size_t f = 0; f < s.faces.size(); f += 3) std::swap(s.faces[f][0], s.faces[f][1]);
  const SurfaceReport r = check_surface(s);
  EXPECT_EQ(r.boundary_edges, 6u);
  EXPECT_EQ(r.boundary_loops, 2u);
  EXPECT_EQ(r.nonmanifold_vertices, 0u);
  EXPECT_GT(r.misoriented_edges, 0u);
}

TEST(CheckSurface, MoebiusStripHasOneLoop) {
  Surface s;
  for (std::uint32_t i = 0; i < 10; ++i) s.positions.push_back({static_cast<double>(i), static_cast<double>(i % 2), 0});
  for (std::uint32_t i = 0; i < 10; i += 2) {
    const std::uint32_t a = i < 8 ? i + 2 : 1, b = i < 8 ? i + 3 : 0;  // the last quad meets the first upside down
    s.faces.push_back({i, i + 1, b});
    s.faces.push_back({i, b, a});
  }
  const SurfaceReport r = check_surface(s);
  EXPECT_EQ(r.boundary_edges, 10u);
  EXPECT_EQ(r.boundary_loops, 1u);
  EXPECT_EQ(r.misoriented_edges, 1u);
  EXPECT_EQ(r.nonmanifold_edges, 0u);
  EXPECT_EQ(r.nonmanifold_vertices, 0u);
}

TEST(CheckSurface, DuplicatesStraysAndFacesWithoutArea) {
  Surface s = kTetrahedron;
  s.positions.push_back({1, 0, -0.0});  // as vertex 1, of no face
  s.positions.push_back({0.5, 0, 0});   // on the edge 0 1
  s.faces.push_back({0, 5, 1});         // no area
  s.faces.push_back({2, 2, 3});         // repeated corner
  s.faces.push_back({2, 3, 1});         // face 2 again
  s.faces.push_back({0, 1, 99});        // out of range
  const SurfaceReport r = check_surface(s);
  EXPECT_EQ(r.duplicate_vertices, 1u);
  EXPECT_EQ(r.unreferenced_vertices, 1u);
  EXPECT_EQ(r.degenerate_faces, 3u);
  EXPECT_EQ(r.duplicate_faces, 1u);
}

TEST(CheckSurface, CloudHasVerticesOnly) {
  const Surface s{{{0, 0, 0}, {1, 0, 0}, {0, 0, 0}, {0, 0, 1}}, {}};
  const SurfaceReport r = check_surface(s);
  EXPECT_EQ(r.vertices, 4u);
  EXPECT_EQ(r.duplicate_vertices, 1u);
  EXPECT_EQ(r.unreferenced_vertices, 0u);
  EXPECT_FALSE(r.closed());
  EXPECT_EQ(check_surface(Surface{}).vertices, 0u);
}

TEST(ValidateSurface, ReportsTheFirstOffender) {
  EXPECT_TRUE(validate_surface(kTetrahedron).has_value());
  Surface s = kTetrahedron;
  s.positions[2][1] = std::nan("");
  EXPECT_NE(validate_surface(s).error().message.find("vertex 2"), std::string::npos);
  s = kTetrahedron;
  s.faces[3][0] = 4;
  EXPECT_NE(validate_surface(s).error().message.find("face 3"), std::string::npos);
  s.positions.resize(3);
  EXPECT_EQ(validate_surface(s).error().code, ErrorCode::kInvalidArgument);
}

TEST(BoundingBox, OfNothingIsEmpty) {
  const Box empty = bounding_box({});
  EXPECT_GT(empty.low[0], empty.high[0]);
  EXPECT_EQ(empty.diagonal(), 0);
  const std::vector<Vec3> p{{0, 0, 0}, {1, 2, 2}};
  EXPECT_DOUBLE_EQ(bounding_box(p).diagonal(), 3);
}

}  // namespace
}  // namespace eigencast
