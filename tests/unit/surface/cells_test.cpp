// SPDX-License-Identifier: MIT
#include "common/surface/cells.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "common/surface/checks/check.h"
#include "common/surface/shapes/shapes.h"
#include "common/surface/vector.h"

namespace eigencast {
namespace {

double volume_of(const Surface& surface) {
  double volume = 0;
  for (const Face& f : surface.faces)
    volume += dot(surface.positions[f[0]], cross(surface.positions[f[1]], surface.positions[f[2]])) / 6;
  return volume;
}

Surface taken(const std::vector<Vec3>& points, const PickedSurface& picked) {
  Surface surface{{}, picked.faces};
  for (const std::uint32_t v : picked.vertices) surface.positions.push_back(points[v]);
  return surface;
}

/// Two cubes beside each other, and a point of no cell before them.
const std::vector<Vec3> kTwoCubes{{9, 9, 9}, {0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}, {0, 0, 1}, {1, 0, 1},
                                  {1, 1, 1}, {0, 1, 1}, {2, 0, 0}, {2, 1, 0}, {2, 0, 1}, {2, 1, 1}};

TEST(Cells, TheBoundaryOfCubesIsClosedAndFacesOutward) {
  const std::vector<std::uint32_t> cells{1, 2, 3, 4, 5, 6, 7, 8, 2, 9, 10, 3, 6, 11, 12, 7};
  const auto boundary = boundary_of(kTwoCubes, cells, CellKind::kHexahedron);
  ASSERT_TRUE(boundary) << boundary.error().message;
  EXPECT_EQ(boundary->faces.size(), 20u);
  EXPECT_EQ(boundary->vertices.size(), 12u) << "without the point of no cell";
  const Surface surface = taken(kTwoCubes, *boundary);
  const SurfaceReport report = check_surface(surface);
  EXPECT_TRUE(report.closed());
  EXPECT_EQ(report.misoriented_edges, 0u);
  EXPECT_NEAR(volume_of(surface), 2, 1e-12);
  std::vector<std::uint32_t> inside_out = cells;  // as programs with another order of corners give them
  std::swap_ranges(inside_out.begin(), inside_out.begin() + 4, inside_out.begin() + 4);
  const auto same = boundary_of(kTwoCubes, inside_out, CellKind::kHexahedron);
  ASSERT_TRUE(same);
  EXPECT_NEAR(volume_of(taken(kTwoCubes, *same)), 2, 1e-12);
}

TEST(Cells, EveryKindHasAClosedBoundaryOfItsVolume) {
  const std::vector<Vec3> cube(kTwoCubes.begin() + 1, kTwoCubes.begin() + 9);
  const struct {
    CellKind kind;
    std::vector<std::uint32_t> cell;
    double volume;
  } cases[] = {{CellKind::kTetrahedron, {0, 1, 2, 5}, 1.0 / 6},
               {CellKind::kHexahedron, {0, 1, 2, 3, 4, 5, 6, 7}, 1},
               {CellKind::kWedge, {0, 1, 3, 4, 5, 7}, 0.5},
               {CellKind::kPyramid, {0, 1, 2, 3, 4}, 1.0 / 3}};
  for (const auto& [kind, cell, volume] : cases) {
    ASSERT_EQ(cell.size(), corners_of(kind));
    const auto boundary = boundary_of(cube, cell, kind);
    ASSERT_TRUE(boundary);
    const Surface surface = taken(cube, *boundary);
    EXPECT_TRUE(check_surface(surface).closed()) << kCellKindNames[kind];
    EXPECT_NEAR(volume_of(surface), volume, 1e-12) << kCellKindNames[kind];
  }
}

TEST(Cells, CellsThatCannotBeMeantAreRefused) {
  const std::vector<std::uint32_t> far{1, 2, 3, 13}, few{1, 2, 3};
  EXPECT_EQ(boundary_of(kTwoCubes, far, CellKind::kTetrahedron).error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(boundary_of(kTwoCubes, few, CellKind::kTetrahedron).error().code, ErrorCode::kInvalidArgument);
}

TEST(Polygons, AreFannedFromTheirFirstCorner) {
  const std::vector<std::uint32_t> corners{4, 5, 6, 7, 8, 9, 1, 2, 3};
  const std::vector<std::uint64_t> offsets{0, 4, 6, 9};
  const auto faces = fanned(corners, offsets);
  ASSERT_TRUE(faces);
  EXPECT_EQ(*faces, (std::vector<Face>{{4, 5, 6}, {4, 6, 7}, {1, 2, 3}})) << "the line of two corners is left out";
  for (const std::vector<std::uint64_t>& wrong :
       {std::vector<std::uint64_t>{}, {0, 4, 6}, {1, 9}, {0, 6, 4, 9}, {0, 10}, {0, 10, 9}})
    EXPECT_EQ(fanned(corners, wrong).error().code, ErrorCode::kInvalidArgument);
}

/// Each face has three vertices of its own, moved by at most `noise`.
Surface soup_of(const Surface& surface, double noise) {
  Surface soup;
  for (const Face& f : surface.faces) {
    Face own;
    for (std::size_t k = 0; k < 3; ++k) {
      own[k] = static_cast<std::uint32_t>(soup.positions.size());
      soup.positions.push_back(surface.positions[f[k]] + Vec3{noise * std::sin(double{1} * own[k]), 0, 0});
    }
    soup.faces.push_back(own);
  }
  return soup;
}

TEST(Welding, MakesASurfaceOfATriangleSoup) {
  const Surface ball = make_icosphere(3);
  EXPECT_FALSE(is_triangle_soup(ball));
  const Surface soup = soup_of(ball, 0);
  EXPECT_TRUE(is_triangle_soup(soup));
  const auto joined = welded(soup, 0);
  ASSERT_TRUE(joined);
  EXPECT_EQ(joined->vertices.size(), ball.vertex_count());
  EXPECT_TRUE(std::is_sorted(joined->vertices.begin(), joined->vertices.end()));
  EXPECT_TRUE(check_surface(taken(soup.positions, *joined)).closed());

  const Surface rough = soup_of(ball, 1e-6);
  EXPECT_EQ(welded(rough, 0)->vertices.size(), rough.vertex_count()) << "no two are at the same place";
  const auto near = welded(rough, 1e-4);
  ASSERT_TRUE(near);
  EXPECT_EQ(near->vertices.size(), ball.vertex_count());
  EXPECT_EQ(near->faces.size(), ball.faces.size());
  EXPECT_TRUE(check_surface(taken(rough.positions, *near)).closed());
  EXPECT_TRUE(welded(ball, 10)->faces.empty()) << "all of it is one point";
}

TEST(Welding, WhatCannotBeMeantIsRefused) {
  Surface ball = make_icosphere(1);
  for (const double tolerance : {-1.0, std::nan(""), std::numeric_limits<double>::infinity(), 1e-300})
    EXPECT_EQ(welded(ball, tolerance).error().code, ErrorCode::kInvalidArgument) << tolerance;
  ball.faces[0][0] = 1000;
  EXPECT_EQ(welded(ball, 0).error().code, ErrorCode::kInvalidArgument);
}

}  // namespace
}  // namespace eigencast
