// SPDX-License-Identifier: MIT
#include "common/surface/shapes/shapes.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "common/surface/checks/check.h"

namespace eigencast {
namespace {

// Divergence theorem; positive when faces point outward.
double volume(const std::vector<Vec3>& p, const std::vector<Face>& faces) {
  double six_volumes = 0;
  for (const Face& f : faces) {
    const Vec3& a = p[f[0]];
    const Vec3& b = p[f[1]];
    const Vec3& c = p[f[2]];
    six_volumes +=
        a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0]);
  }
  return six_volumes / 6;
}

double smallest_angle_degrees(const Surface& s) {
  double smallest = 180;
  for (const Face& f : s.faces) {
    for (std::size_t k = 0; k < 3; ++k) {
      const Vec3& a = s.positions[f[k]];
      const Vec3& b = s.positions[f[(k + 1) % 3]];
      const Vec3& c = s.positions[f[(k + 2) % 3]];
      const Vec3 u{b[0] - a[0], b[1] - a[1], b[2] - a[2]};
      const Vec3 v{c[0] - a[0], c[1] - a[1], c[2] - a[2]};
      const double dot = u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
      const double cross = std::hypot(u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]);
      smallest = std::min(smallest, std::atan2(cross, dot) * 180 / std::numbers::pi);
    }
  }
  return smallest;
}

void expect_closed_manifold(const Surface& s, long euler) {
  ASSERT_TRUE(validate_surface(s).has_value());
  const SurfaceReport r = check_surface(s);
  EXPECT_TRUE(r.closed()) << text_from_report(r);
  EXPECT_EQ(r.components, 1u);
  EXPECT_EQ(r.nonmanifold_vertices, 0u);
  EXPECT_EQ(r.misoriented_edges, 0u);
  EXPECT_EQ(r.duplicate_vertices, 0u);
  EXPECT_EQ(r.unreferenced_vertices, 0u);
  EXPECT_EQ(r.degenerate_faces, 0u);
  EXPECT_EQ(r.duplicate_faces, 0u);
  const long vertices = static_cast<long>(s.vertex_count());
  const long faces = static_cast<long>(s.faces.size());
  EXPECT_EQ(vertices - faces * 3 / 2 + faces, euler);
}

TEST(Shapes, Icosphere) {
  for (int s = 0; s <= 5; ++s) {
    const Surface sphere = make_icosphere(s);
    EXPECT_EQ(sphere.vertex_count(), 10u * (1u << (2 * s)) + 2);
    expect_closed_manifold(sphere, 2);
    for (const Vec3& p : sphere.positions) EXPECT_NEAR(std::hypot(p[0], p[1], p[2]), 1, 1e-15);
  }
  const Surface fine = make_icosphere(5);
  EXPECT_NEAR(volume(fine.positions, fine.faces), 4 * std::numbers::pi / 3, 5e-3);
}

TEST(Shapes, TorusHasGenusOne) {
  const Surface torus = make_torus(100, 50, 1, 0.4);
  EXPECT_EQ(torus.vertex_count(), 5000u);
  expect_closed_manifold(torus, 0);
  EXPECT_NEAR(volume(torus.positions, torus.faces), 2 * std::numbers::pi * std::numbers::pi * 0.16, 0.02);
}

TEST(Shapes, BoxOfThePaperHasItsCounts) {
  const Surface box = make_box(40, 40, 185, {1, 2, 3});
  EXPECT_EQ(box.vertex_count(), 32802u);
  EXPECT_EQ(box.faces.size(), 65600u);
  expect_closed_manifold(box, 2);
  EXPECT_NEAR(volume(box.positions, box.faces), 6, 1e-12);
  expect_closed_manifold(make_box(1, 1, 1, {1, 1, 1}), 2);
}

TEST(Shapes, HeartIsClosedEvenAndUpright) {
  const Surface heart = make_heart(27);
  EXPECT_EQ(heart.vertex_count(), 7292u);
  expect_closed_manifold(heart, 2);
  EXPECT_GT(volume(heart.positions, heart.faces), 1);
  EXPECT_GT(smallest_angle_degrees(heart), 35);
  // The tip is the one lowest point, near the axis; the two lobes are highest, left and right of the cleft.
  const auto by_height = [](const Vec3& a, const Vec3& b) { return a[1] < b[1]; };
  const auto [tip, top] = std::minmax_element(heart.positions.begin(), heart.positions.end(), by_height);
  EXPECT_NEAR((*tip)[0], 0, 0.05);
  EXPECT_GT(std::abs((*top)[0]), 0.2);
}

TEST(Builtins, EachIsClosedPeriodicFiniteAndDeterministic) {
  for (const std::string& name : builtin_names()) {
    SCOPED_TRACE(name);
    auto made = builtin_clip(name, 10);
    ASSERT_TRUE(made.has_value()) << made.error().message;
    const MotionClip& clip = **made;
    EXPECT_EQ(clip.name(), name);
    EXPECT_EQ(clip.frame_rate_hz(), 10);
    expect_closed_manifold(clip.rest(), name == "torus" ? 0 : 2);
    const double rest_volume = volume(clip.rest().positions, clip.rest().faces);
    const double diagonal = bounding_box(clip.rest().positions).diagonal();
    ASSERT_GE(clip.frame_count(), 10u);

    std::vector<std::vector<Vec3>> poses;
    double largest_step = 0;
    double largest_move = 0;
    for (std::size_t i = 0; i <= clip.frame_count(); ++i) {
      auto pose = clip.pose(i % clip.frame_count());
      ASSERT_TRUE(pose.has_value());
      ASSERT_EQ(pose->size(), clip.rest().vertex_count());
      for (std::size_t v = 0; v < pose->size(); ++v) {
        for (std::size_t c = 0; c < 3; ++c) {
          const double x = (*pose)[v][c];
          ASSERT_TRUE(std::isfinite(x));
          if (i > 0) largest_step = std::max(largest_step, std::abs(x - poses.back()[v][c]));
          largest_move = std::max(largest_move, std::abs(x - clip.rest().positions[v][c]));
        }
      }
      const double v = volume(*pose, clip.rest().faces);
      EXPECT_GT(v, 0.5 * rest_volume);
      EXPECT_LT(v, 1.5 * rest_volume);
      poses.push_back(std::move(*pose));
    }
    EXPECT_EQ(poses.front(), poses.back());
    EXPECT_GT(largest_move, 0.02 * diagonal) << "it should move";
    EXPECT_LT(largest_step, 0.3 * diagonal) << "also from the last pose to the first";
  }
}

TEST(Builtins, VelocitiesAreDerivativesOfPoses) {
  for (const std::string& name : builtin_names()) {
    SCOPED_TRACE(name);
    const auto made = builtin_clip(name, 1000);
    const MotionClip& clip = **made;
    ASSERT_TRUE(clip.has_velocities());
    const std::size_t middle = clip.frame_count() / 3;
    const auto before = clip.pose(middle - 1), after = clip.pose(middle + 1), velocity = clip.velocity(middle);
    double fastest = 0, worst = 0;
    for (std::size_t v = 0; v < velocity->size(); ++v) {
      for (std::size_t c = 0; c < 3; ++c) {
        const double difference = ((*after)[v][c] - (*before)[v][c]) * 500;
        fastest = std::max(fastest, std::abs((*velocity)[v][c]));
        worst = std::max(worst, std::abs((*velocity)[v][c] - difference));
      }
    }
    EXPECT_GT(fastest, 0.1);
    EXPECT_LT(worst, 1e-4 * fastest) << "a central difference is off by the square of a millisecond";
  }
}

TEST(Builtins, BarAndHeartHaveTheStatedSizes) {
  EXPECT_EQ((*builtin_clip("bar"))->rest().vertex_count(), 32802u);
  EXPECT_EQ((*builtin_clip("bar:twist"))->rest().faces.size(), 65600u);
  EXPECT_EQ((*builtin_clip("heart"))->rest().vertex_count(), 7292u);
  EXPECT_EQ((*builtin_clip("heart:fine"))->rest().vertex_count(), 56252u);
  EXPECT_EQ((*builtin_clip("sphere"))->rest().vertex_count(), 10242u);
}

TEST(Builtins, BendsAndTwistsReachTheirAngles) {
  auto clip = builtin_clip("bar:bend", 30);
  const auto quarter = (*clip)->pose((*clip)->frame_count() / 4);
  // At 180 degrees the two end caps face the same way: the axis is half a circle of the bar's length.
  const Box box = bounding_box(*quarter);
  const double outer_radius = 4.625 / std::numbers::pi + 0.5;
  EXPECT_NEAR(box.high[1] - box.low[1], 2 * outer_radius, 1e-2);
  auto twist = builtin_clip("bar:twist", 30);
  const auto turned = (*twist)->pose((*twist)->frame_count() / 4);
  for (std::size_t i = 0; i < turned->size(); ++i) {
    const Vec3& p = (*twist)->rest().positions[i];
    const Vec3& q = (*turned)[i];
    EXPECT_NEAR(std::hypot(p[0], p[2]), std::hypot(q[0], q[2]), 1e-12);
    EXPECT_EQ(p[1], q[1]);
  }
}

TEST(Builtins, UnknownNamesAndRatesAreRefused) {
  const auto unknown = builtin_clip("cube");
  ASSERT_FALSE(unknown.has_value());
  EXPECT_EQ(unknown.error().code, ErrorCode::kNotFound);
  EXPECT_NE(unknown.error().message.find("bar:twist"), std::string::npos);
  for (const double rate : {0.0, -1.0, 1e9, std::nan("")}) {
    EXPECT_EQ(builtin_clip("bar", rate).error().code, ErrorCode::kInvalidArgument);
  }
}

}  // namespace
}  // namespace eigencast
