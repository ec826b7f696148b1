// SPDX-License-Identifier: MIT
#include "common/surface/checks/orientation.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "common/surface/shapes/shapes.h"
#include "common/surface/vector.h"

namespace eigencast {
namespace {

double volume_of(const Surface& surface) {
  double sum = 0;
  for (const auto& [a, b, c] : surface.faces)
    sum += dot(surface.positions[a], cross(surface.positions[b], surface.positions[c])) / 6;
  return sum;
}

/// Turns faces that a fixed rule picks.
void spoil(Surface& surface) {
  std::vector<bool> turned(surface.faces.size());
  for (std::size_t f = 0; f < turned.size(); ++f) turned[f] = f * 7919 % 5 < 2;
  turn_faces(turned, surface.faces);
}

Surface repaired(Surface surface) {
  turn_faces(faces_to_turn(surface), surface.faces);
  return surface;
}

Surface ball() {
  return make_icosphere(3);
}

void append(const Surface& more, const Vec3& by, Surface& to) {
  const auto first = static_cast<std::uint32_t>(to.positions.size());
  for (const Vec3& p : more.positions) to.positions.push_back(p + by);
  for (const auto& [a, b, c] : more.faces) to.faces.push_back({a + first, b + first, c + first});
}

TEST(Orientation, ConsistentSurfacesStayAsTheyAre) {
  Surface surface = ball();
  EXPECT_TRUE(faces_to_turn(surface).empty());
  turn_faces(std::vector<bool>(surface.faces.size(), true), surface.faces);
  surface.faces.pop_back();
  EXPECT_TRUE(faces_to_turn(surface).empty()) << "inside out and open, but of one mind";
  surface.faces.clear();
  EXPECT_TRUE(faces_to_turn(surface).empty()) << "a cloud";
}

TEST(Orientation, ClosedSurfacesEncloseSomething) {
  Surface hollow = ball(), small = ball();
  for (Vec3& p : small.positions) p = 0.5 * p;
  turn_faces(std::vector<bool>(small.faces.size(), true), small.faces);  // The wall of a hole looks into it.
  append(small, {0, 0, 0}, hollow);
  EXPECT_TRUE(faces_to_turn(hollow).empty());
  for (Surface surface : {ball(), hollow}) {
    for (Vec3& p : surface.positions) p = p + Vec3{1e3, 0, 0};
    const Surface good = surface;
    turn_faces(std::vector<bool>(surface.faces.size(), true), surface.faces);
    EXPECT_EQ(repaired(surface).faces, good.faces);
  }
}

TEST(Orientation, ContradictingFacesFaceOutwards) {
  const Surface good = ball();
  Surface surface = good;
  spoil(surface);
  EXPECT_EQ(repaired(surface).faces, good.faces);
  turn_faces(std::vector<bool>(surface.faces.size(), true), surface.faces);
  EXPECT_EQ(repaired(surface).faces, good.faces) << "whichever are more";
}

TEST(Orientation, PartsAreTurnedEachForItself) {
  Surface good = ball(), surface = ball();
  append(ball(), {3, 0, 0}, good);
  turn_faces(std::vector<bool>(surface.faces.size(), true), surface.faces);
  append(ball(), {3, 0, 0}, surface);
  std::swap(surface.faces.back()[1], surface.faces.back()[2]);
  EXPECT_EQ(repaired(surface).faces, good.faces);
}

TEST(Orientation, OpenSurfacesShowTheirOutside) {
  Surface good = ball();
  std::erase_if(good.faces, [&](const Face& f) { return good.positions[f[0]][2] > 0.5; });
  Surface surface = good;
  spoil(surface);
  EXPECT_EQ(repaired(surface).faces, good.faces);
}

TEST(Orientation, VerticesAtOnePositionAreOne) {
  const Surface whole = ball();
  Surface good;
  for (const Face& face : whole.faces) {
    for (const std::uint32_t v : face) good.positions.push_back(whole.positions[v]);
    const auto n = static_cast<std::uint32_t>(good.positions.size());
    good.faces.push_back({n - 3, n - 2, n - 1});
  }
  EXPECT_TRUE(faces_to_turn(good).empty());
  Surface surface = good;
  spoil(surface);
  EXPECT_EQ(repaired(surface).faces, good.faces);
  EXPECT_GT(volume_of(repaired(surface)), 3);
}

TEST(Orientation, OddSurfacesAreTaken) {
  const Surface moebius{{{0, 0, 0}, {0, 1, 0}, {1, 0, 0}, {1, 1, 0}, {2, 0, 1}, {2, 1, 1}},
                        {{0, 1, 2}, {2, 1, 3}, {2, 3, 4}, {4, 3, 5}, {4, 5, 1}, {1, 5, 0}}};
  const auto turned = faces_to_turn(moebius);
  EXPECT_TRUE(turned.empty() || turned.size() == moebius.faces.size());
  const Surface flat{{{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {0, 0, 0}}, {{0, 1, 2}, {1, 2, 0}, {0, 0, 1}, {3, 2, 1}}};
  EXPECT_NO_FATAL_FAILURE((void)faces_to_turn(flat)) << "no area";
}

}  // namespace
}  // namespace eigencast
