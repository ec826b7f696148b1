// SPDX-License-Identifier: MIT
#include "common/progressive/prefix.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <set>
#include <span>

#include "tests/unit/progressive/meshes.h"

namespace eigencast {
namespace {

using testing::append;
using testing::euler_characteristic;
using testing::flat_square;
using testing::soup_from;
using testing::sphere;
using testing::tangle;
using testing::torus;

PrefixOrder order_of(const Surface& surface) {
  auto order = build_prefix_order(surface);
  EXPECT_TRUE(order) << (order ? "" : order.error().message);
  return order ? *order : PrefixOrder{};
}

bool is_repeated(const Face& f) {
  return f[0] == f[1] || f[1] == f[2] || f[2] == f[0];
}

std::vector<Face> faces_at(const PrefixOrder& p, std::uint32_t N) {
  std::vector<Face> faces;
  const std::uint32_t alive = prefix_face_count(p.death, N);
  for (std::uint32_t f = 0; f < alive; ++f) {
    Face face = p.faces[f];
    for (std::uint32_t& corner : face) corner = prefix_corner(p.map, corner, N);
    faces.push_back(face);
  }
  return faces;
}

std::vector<std::uint32_t> some_levels(const PrefixOrder& p) {
  const auto n = static_cast<std::uint32_t>(p.order.size());
  std::vector<std::uint32_t> levels;
  const std::uint32_t step = std::max(1U, (n - p.base_count) / 40);
  for (std::uint32_t N = p.base_count; N < n; N += step) levels.push_back(N);
  levels.push_back(n);
  return levels;
}

std::size_t edges_of(const std::vector<Face>& faces) {
  std::set<std::pair<std::uint32_t, std::uint32_t>> edges;
  for (const Face& f : faces) {
    for (std::size_t c = 0; c < 3; ++c) edges.insert(std::minmax(f[c], f[(c + 1) % 3]));
  }
  return edges.size();
}

// Everything that receivers rely on, for any surface whatever.
void expect_valid(const Surface& surface, const PrefixOrder& p) {
  const auto n = static_cast<std::uint32_t>(surface.positions.size());
  ASSERT_EQ(p.order.size(), n);
  ASSERT_EQ(p.map.size(), n);
  ASSERT_GE(p.base_count, std::min(n, 4U));
  ASSERT_LE(p.base_count, n);
  EXPECT_EQ(std::set<std::uint32_t>(p.order.begin(), p.order.end()).size(), n);
  EXPECT_LT(*std::max_element(p.order.begin(), p.order.end()), n);
  for (std::uint32_t i = 0; i < p.base_count; ++i) ASSERT_EQ(p.map[i], i);
  for (std::uint32_t i = p.base_count; i < n; ++i) ASSERT_LT(p.map[i], i);

  // All faces of the source that have three corners, each once, with its own corners in its own turn.
  std::size_t proper = 0;
  for (const Face& face : surface.faces) proper += is_repeated(face) ? 0 : 1;
  ASSERT_EQ(p.faces.size(), proper);
  ASSERT_EQ(p.death.size(), proper);
  ASSERT_EQ(p.face_source.size(), proper);
  EXPECT_EQ(std::set<std::uint32_t>(p.face_source.begin(), p.face_source.end()).size(), proper);
  for (std::size_t f = 0; f < proper; ++f) {
    for (std::size_t c = 0; c < 3; ++c) ASSERT_EQ(p.order[p.faces[f][c]], surface.faces[p.face_source[f]][c]);
  }
  EXPECT_TRUE(std::is_sorted(p.death.begin(), p.death.end()));
  EXPECT_EQ(prefix_face_count(p.death, n), proper);

  for (const std::uint32_t N : some_levels(p)) {
    for (const Face& face : faces_at(p, N)) {
      ASSERT_FALSE(is_repeated(face)) << "N = " << N;
      ASSERT_LT(std::max({face[0], face[1], face[2]}), N);
    }
    // Conversely: a face that is not shown has lost an edge.
    for (std::uint32_t f = prefix_face_count(p.death, N); f < p.faces.size(); ++f) {
      Face face = p.faces[f];
      for (std::uint32_t& corner : face) corner = prefix_corner(p.map, corner, N);
      ASSERT_TRUE(is_repeated(face)) << "N = " << N << ", face " << f;
    }
  }
}

TEST(Prefix, KeepsEulerCharacteristicOfClosedMeshes) {
  const std::pair<Surface, int> cases[] = {{sphere(4), 2}, {torus(60, 24), 0}, {sphere(1), 2}, {torus(5, 5), 0}};
  for (const auto& [surface, characteristic] : cases) {
    const PrefixOrder p = order_of(surface);
    expect_valid(surface, p);
    for (const std::uint32_t N : some_levels(p)) {
      const auto faces = faces_at(p, N);
      ASSERT_EQ(euler_characteristic(faces, N), characteristic) << "N = " << N;
      ASSERT_EQ(2 * edges_of(faces), 3 * faces.size());
    }
  }
}

TEST(Prefix, ReachesABaseOfOnePercent) {
  const Surface surface = sphere(5);
  EXPECT_EQ(order_of(surface).base_count, surface.vertex_count() / 100);
  EXPECT_EQ(order_of(sphere(0)).base_count, 4U);
}

TEST(Prefix, EachStepMovesOneVertexOntoItsTarget) {
  for (const Surface& surface : {torus(40, 20), sphere(2)}) {
    const PrefixOrder p = order_of(surface);
    for (std::uint32_t N = static_cast<std::uint32_t>(p.order.size()); N > p.base_count; --N) {
      std::vector<Face> before = faces_at(p, N);
      const std::vector<Face> after = faces_at(p, N - 1);
      ASSERT_EQ(before.size(), after.size() + 2) << "an edge of a closed mesh has two faces";
      before.resize(after.size());
      for (Face& face : before) std::replace(face.begin(), face.end(), N - 1, p.map[N - 1]);
      ASSERT_EQ(before, after);
    }
  }
}

TEST(Prefix, IsDeterministic) {
  const Surface surface = soup_from(torus(30, 12));
  const PrefixOrder a = order_of(surface), b = order_of(surface);
  EXPECT_EQ(a.order, b.order);
  EXPECT_EQ(a.map, b.map);
  EXPECT_EQ(a.faces, b.faces);
}

// The order must not depend on where the model stands or on its unit.
TEST(Prefix, DoesNotDependOnPowersOfTwoOfTheUnit) {
  const Surface surface = torus(30, 12);
  Surface scaled = surface;
  for (Vec3& p : scaled.positions) {
    for (double& value : p) value *= 1 << 20;
  }
  EXPECT_EQ(order_of(surface).order, order_of(scaled).order);
}

TEST(Prefix, CoarseSphereStaysASphere) {
  const Surface surface = sphere(4);
  const PrefixOrder p = order_of(surface);
  const auto n = static_cast<std::uint32_t>(surface.vertex_count());
  for (const std::uint32_t N : {n / 2, n / 5, n / 10, n / 20}) {
    double volume = 0;
    for (const Face& f : faces_at(p, N)) {
      const Vec3 &a = surface.positions[p.order[f[0]]], &b = surface.positions[p.order[f[1]]],
                 &c = surface.positions[p.order[f[2]]];
      const double part =
          a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0]);
      EXPECT_GT(part, 0) << "a face shows its back, N = " << N;
      volume += part / 6;
    }
    // An inscribed polyhedron of N vertices lacks about 8.5/N of the ball at best; two and a half times that is still a
    // fair one.
    EXPECT_LT(volume, 4 * M_PI / 3);
    EXPECT_GT(volume, 4 * M_PI / 3 * (1 - 21.0 / N)) << "N = " << N;
  }
}

TEST(Prefix, BoundaryKeepsItsArea) {
  const Surface surface = flat_square(40);
  const PrefixOrder p = order_of(surface);
  expect_valid(surface, p);
  double whole = 0;
  for (const std::uint32_t N : some_levels(p)) {
    double area = 0;
    for (const Face& f : faces_at(p, N)) {
      const Vec3 &a = surface.positions[p.order[f[0]]], &b = surface.positions[p.order[f[1]]],
                 &c = surface.positions[p.order[f[2]]];
      const double part = ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])) / 2;
      ASSERT_GT(part, 0);
      area += part;
    }
    whole = whole > 0 ? whole : area;
    EXPECT_NEAR(area, 0.975 * 0.975, 1e-9) << "N = " << N;
    EXPECT_EQ(euler_characteristic(faces_at(p, N), N), 1);
  }
}

TEST(Prefix, SoupIsWeldedFirst) {
  const Surface whole = sphere(3), surface = soup_from(whole);
  const PrefixOrder p = order_of(surface);
  expect_valid(surface, p);
  const auto vertices = static_cast<std::uint32_t>(whole.vertex_count());
  EXPECT_EQ(prefix_face_count(p.death, vertices), whole.faces.size()) << "no face is lost while there are duplicates";
  EXPECT_EQ(p.base_count, std::max<std::size_t>(4, vertices / 100));
}

TEST(Prefix, UnreferencedVerticesGoFirst) {
  Surface surface = sphere(2);
  const auto used = static_cast<std::uint32_t>(surface.vertex_count());
  for (int i = 0; i < 50; ++i) surface.positions.push_back({i * 0.1, 2, 3});
  const PrefixOrder p = order_of(surface);
  expect_valid(surface, p);
  for (std::uint32_t i = 0; i < used; ++i) EXPECT_LT(p.order[i], used);
  EXPECT_EQ(prefix_face_count(p.death, used), surface.faces.size());
}

TEST(Prefix, FacesWithARepeatedCornerAreLeftOut) {
  Surface surface = sphere(2);
  surface.faces.push_back({3, 3, 4});
  surface.faces.insert(surface.faces.begin(), {5, 1, 5});
  expect_valid(surface, order_of(surface));
}

TEST(Prefix, SmallComponentsVanishBeforeTheLargeOneSuffers) {
  Surface surface = sphere(4);
  Surface crumb = sphere(0);
  for (Vec3& p : crumb.positions) {
    for (double& value : p) value *= 0.01;
  }
  for (int i = 0; i < 30; ++i) append(surface, crumb, {2 + 0.1 * i, 0, 0});
  const PrefixOrder p = order_of(surface);
  expect_valid(surface, p);
  const auto large = static_cast<std::uint32_t>(sphere(4).vertex_count());
  std::size_t of_large = 0;
  for (std::uint32_t i = 0; i < p.base_count; ++i) of_large += p.order[i] < large ? 1 : 0;
  EXPECT_EQ(of_large, p.base_count);
}

TEST(Prefix, AnySurfaceGetsAnOrderAndASmallBase) {
  std::vector<Surface> surfaces;
  for (unsigned seed = 0; seed < 4; ++seed) surfaces.push_back(tangle(500, 300 << seed, seed));
  Surface doubled = sphere(3);  // Each face twice, the second time from behind.
  for (const Face& f : sphere(3).faces) doubled.faces.push_back({f[1], f[0], f[2]});
  surfaces.push_back(doubled);
  Surface fan{{{0, 0, 0}, {0, 0, 1}}, {}};  // A book: one edge of 400 faces.
  for (std::uint32_t i = 0; i < 400; ++i) {
    fan.positions.push_back({std::cos(i * 0.01), std::sin(i * 0.01), 0.5});
    fan.faces.push_back({0, 1, i + 2});
  }
  surfaces.push_back(fan);
  Surface crumbs;
  for (int i = 0; i < 200; ++i)
    append(crumbs, Surface{{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, {{0, 1, 2}}}, {3.0 * i, 0, 0});
  surfaces.push_back(crumbs);
  Surface line;  // No area at all.
  for (std::uint32_t i = 0; i < 300; ++i) line.positions.push_back({i * 1.0, 0, 0});
  for (std::uint32_t i = 0; i + 2 < 300; ++i) line.faces.push_back({i, i + 1, i + 2});
  surfaces.push_back(line);
  for (std::size_t i = 0; i < surfaces.size(); ++i) {
    SCOPED_TRACE(i);
    const PrefixOrder p = order_of(surfaces[i]);
    expect_valid(surfaces[i], p);
    EXPECT_LE(p.base_count, 64U);
  }
}

TEST(Prefix, DegenerateSurfaces) {
  const Vec3 a{0, 0, 0};
  const double huge = std::numeric_limits<double>::max();
  const Surface surfaces[] = {
      {{a, a, a, a}, {{0, 1, 2}}},                          // all at one point
      {{a, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, {{0, 1, 2}}},  // one face
      {{a, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, {{0, 0, 2}}},  // no proper face
      {{{-huge, 0, 0}, {huge, 0, 0}, {0, huge, 0}, {0, 0, -huge}}, {{0, 1, 2}, {0, 2, 3}}},
      {{a}, {}},
      {std::vector<Vec3>(100, a), {}},
  };
  for (const Surface& surface : surfaces) expect_valid(surface, order_of(surface));
}

TEST(Prefix, RefusesInvalidSurfaces) {
  EXPECT_EQ(build_prefix_order(Surface{}).error().code, ErrorCode::kInvalidArgument);
  Surface surface = sphere(1);
  surface.faces[3][1] = 1000;
  EXPECT_THAT(build_prefix_order(surface).error().message,
              ::testing::AllOf(::testing::HasSubstr("face 3 "), ::testing::HasSubstr("vertex 1000")));
  surface = sphere(1);
  surface.positions[7][2] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_NE(build_prefix_order(surface).error().message.find("vertex 7"), std::string::npos);
}

// Without its guard the hub would be asked about each of its neighbours after each contraction.
TEST(Prefix, WheelOfThousandsOfFacesIsContracted) {
  constexpr std::uint32_t kRim = 4000;
  Surface wheel{{{0, 0, 0.5}}, {}};
  for (std::uint32_t i = 0; i < kRim; ++i) {
    const double angle = 2 * M_PI * i / kRim;
    wheel.positions.push_back({std::cos(angle), std::sin(angle), 0});
    wheel.faces.push_back({0, 1 + i, 1 + (i + 1) % kRim});
  }
  const PrefixOrder order = order_of(wheel);
  expect_valid(wheel, order);
  EXPECT_LE(order.base_count, 50u);
  const auto base = std::span(order.order).first(order.base_count);
  EXPECT_NE(std::find(base.begin(), base.end(), 0u), base.end()) << "the hub";
}

TEST(Prefix, CancelledOrdersAreStillOrders) {
  const std::atomic<bool> unwanted = true;
  Surface points = sphere(3);
  points.faces.clear();
  for (const Surface& surface : {sphere(3), points}) {
    const auto order = build_prefix_order(surface, {}, {}, unwanted);
    ASSERT_TRUE(order) << order.error().message;
    EXPECT_EQ(order->base_count, surface.vertex_count()) << "nothing was contracted";
    EXPECT_EQ(std::set(order->order.begin(), order->order.end()).size(), surface.vertex_count());
    EXPECT_EQ(order->faces.size(), surface.faces.size());
  }
}

TEST(PrefixPoses, NoFaceSpansAFoldOfAnotherPose) {
  const Surface sheet = flat_square(40);
  std::vector<std::vector<Vec3>> poses = {sheet.positions};
  for (Vec3& p : poses[0]) p[2] = std::abs(p[0] - 0.5);
  const auto faces_across = [&](const PrefixOrder& p) {
    const std::vector<Face> faces = faces_at(p, 160);
    return std::count_if(faces.begin(), faces.end(), [&](const Face& face) {
      const auto u = [&](std::size_t corner) { return sheet.positions[p.order[face[corner]]][0]; };
      return std::min({u(0), u(1), u(2)}) < 0.5 && std::max({u(0), u(1), u(2)}) > 0.5;
    });
  };
  const auto folded = build_prefix_order(sheet, {}, poses);
  ASSERT_TRUE(folded);
  expect_valid(sheet, *folded);
  EXPECT_EQ(faces_across(*folded), 0);
  EXPECT_GT(faces_across(order_of(sheet)), 5);
}

TEST(PrefixPoses, VerticesTogetherOnlyAtRestAreNotWelded) {
  Surface halves = flat_square(8);
  append(halves, flat_square(8), {0.875, 0, 0});  // whose first column is the other's last
  std::vector<std::vector<Vec3>> poses = {halves.positions};
  for (std::size_t i = 64; i < 128; ++i) poses[0][i][0] += 0.5;
  const auto crossings = [](const PrefixOrder& p) {
    int count = 0;
    for (std::uint32_t i = 32; i < 128; ++i) count += (p.order[i] < 64) != (p.order[p.map[i]] < 64);
    return count;
  };
  const auto apart = build_prefix_order(halves, {}, poses);
  ASSERT_TRUE(apart);
  expect_valid(halves, *apart);
  EXPECT_EQ(crossings(*apart), 0);
  EXPECT_GE(crossings(order_of(halves)), 8);
}

TEST(PrefixPoints, CoversTheSphereEvenly) {
  Surface cloud = sphere(4);
  cloud.faces.clear();
  const PrefixOrder p = order_of(cloud);
  expect_valid(cloud, p);
  EXPECT_EQ(p.base_count, cloud.vertex_count() / 100);
  // With N points left no point of the sphere is further from them than a few times their mean spacing.
  for (const std::uint32_t N : {512U, 128U, 32U}) {
    double worst = 0;
    for (const Vec3& x : cloud.positions) {
      double nearest = 10;
      for (std::uint32_t i = 0; i < N; ++i) {
        const Vec3& y = cloud.positions[p.order[i]];
        nearest = std::min(nearest, std::hypot(x[0] - y[0], x[1] - y[1], x[2] - y[2]));
      }
      worst = std::max(worst, nearest);
    }
    EXPECT_LT(worst, 2 * std::sqrt(4 * M_PI / N)) << "N = " << N;
  }
}

TEST(PrefixPoints, FarGroupsAndDuplicates) {
  Surface cloud;
  for (int group = 0; group < 60; ++group) {
    for (int i = 0; i < 20; ++i) {
      for (int copy = 0; copy < 2; ++copy) cloud.positions.push_back({100.0 * group, std::cos(i), std::sin(i)});
    }
  }
  const PrefixOrder p = order_of(cloud);
  expect_valid(cloud, p);
  EXPECT_EQ(p.base_count, 12U);
  for (std::uint32_t i = 0; i < 1200; ++i) EXPECT_EQ(p.order[i] % 2, 0U) << "duplicates go first";
}

}  // namespace
}  // namespace eigencast
