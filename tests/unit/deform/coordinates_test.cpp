// SPDX-License-Identifier: MIT

#include <gtest/gtest.h>

#include <cmath>
#include <numeric>
#include <random>

#include "common/surface/shapes/shapes.h"
#include "common/surface/vector.h"
#include "sender/deform/cage.h"
#include "sender/deform/moves.h"

namespace eigencast::deform {
namespace {

/// A cage without symmetry: a box of random proportions whose corners were pushed about.
Surface uneven_cage(unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> push(-0.08, 0.08);
  Surface cage = make_box(2, 3, 2, {1.3, 2.1, 0.9});
  for (Vec3& p : cage.positions) p = p + Vec3{push(random), push(random), push(random)};
  return cage;
}

std::vector<Vec3> points_inside(unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> coordinate(-0.35, 0.35);
  std::vector<Vec3> points;
  for (int i = 0; i < 40; ++i) points.push_back({coordinate(random), 2 * coordinate(random), coordinate(random)});
  return points;
}

struct Green {
  Green(const Surface& cage, const Vec3& p) : phi(cage.vertex_count()), psi(cage.faces.size()) {
    green_coordinates(cage, p, phi, psi);
  }
  Vec3 rebuilt(const Surface& rest, std::span<const Vec3> moved) const {
    Vec3 p{};
    for (std::size_t i = 0; i < phi.size(); ++i) p = p + phi[i] * moved[i];
    const std::vector<Vec3> normals = stretched_normals(rest, moved);
    for (std::size_t j = 0; j < psi.size(); ++j) p = p + psi[j] * normals[j];
    return p;
  }
  std::vector<double> phi, psi;
};

double sum(const std::vector<double>& values) {
  return std::accumulate(values.begin(), values.end(), 0.0);
}

TEST(GreenCoordinates, ReproducePointsInsideTheCage) {
  for (unsigned seed = 0; seed < 4; ++seed) {
    const Surface cage = uneven_cage(seed);
    for (const Vec3& p : points_inside(seed)) {
      const Green green(cage, p);
      EXPECT_NEAR(sum(green.phi), 1, 1e-12);
      EXPECT_LT(length(green.rebuilt(cage, cage.positions) - p), 1e-12);
      for (const double psi : green.psi) EXPECT_GT(psi, 0) << "the potential of a face";
    }
    const Green outside(cage, {3, 1, 2});
    EXPECT_NEAR(sum(outside.phi), 0, 1e-12) << "no coordinates outside";
  }
}

TEST(GreenCoordinates, FollowEverySimilarityExactly) {
  const Surface cage = uneven_cage(7);
  const auto similarity = [](const Vec3& p) {
    return 1.7 * turned(turned(p, {0.2, 0, 0.4}, 1, 0.9), {}, 0, -2.1) + Vec3{4, -3, 2};
  };
  std::vector<Vec3> moved;
  for (const Vec3& p : cage.positions) moved.push_back(similarity(p));
  for (const Vec3& p : points_inside(7)) {
    EXPECT_LT(length(Green(cage, p).rebuilt(cage, moved) - similarity(p)), 1e-12 * 10);
  }
}

// By quadrature of their definition: psi = int 1/(4 pi r), phi = int Gamma (xi - eta).n / (4 pi r^3).
TEST(GreenCoordinates, AreTheIntegralsThatDefineThem) {
  const Surface cage = uneven_cage(3);
  const Vec3 eta{0.1, -0.3, 0.05};
  const Green green(cage, eta);
  std::vector<double> phi(green.phi.size()), psi(green.psi.size());
  constexpr int kSteps = 200;
  for (std::size_t f = 0; f < cage.faces.size(); ++f) {
    const Face& face = cage.faces[f];
    const Vec3 a = cage.positions[face[0]], u = cage.positions[face[1]] - a, v = cage.positions[face[2]] - a;
    const Vec3 normal = unit(cross(u, v));
    const double cell = length(cross(u, v)) / 2 / (kSteps * kSteps);
    const auto add = [&](double s, double t) {
      const Vec3 to = a + s * u + t * v - eta;
      const double r = length(to), dipole = dot(to, normal) / (r * r * r) * cell / (4 * std::numbers::pi);
      psi[f] += cell / (4 * std::numbers::pi * r);
      phi[face[0]] += (1 - s - t) * dipole;
      phi[face[1]] += s * dipole;
      phi[face[2]] += t * dipole;
    };
    for (int i = 0; i < kSteps; ++i) {
      for (int j = 0; i + j < kSteps; ++j) {
        add((i + 1.0 / 3) / kSteps, (j + 1.0 / 3) / kSteps);
        if (i + j + 1 < kSteps) add((i + 2.0 / 3) / kSteps, (j + 2.0 / 3) / kSteps);
      }
    }
  }
  for (std::size_t i = 0; i < phi.size(); ++i) EXPECT_NEAR(green.phi[i], phi[i], 1e-5);
  for (std::size_t j = 0; j < psi.size(); ++j) EXPECT_NEAR(green.psi[j], psi[j], 1e-5);
}

TEST(GreenCoordinates, StayBoundedNearFacesEdgesAndCorners) {
  const Surface cage = make_box(1, 1, 1, {2, 2, 2});
  for (const Vec3& target : {Vec3{0.3, 1, 0.2}, Vec3{1, 1, 0.3}, Vec3{0, 1, 0}, Vec3{1, 1, 1}}) {
    for (double gap = 0.1; gap > 1e-13; gap *= 0.1) {
      const Vec3 p = (1 - gap) * target;
      const Green green(cage, p);
      double largest = 0;
      for (const double value : green.phi) largest = std::max(largest, std::abs(value));
      for (const double value : green.psi) largest = std::max(largest, std::abs(value));
      EXPECT_LT(largest, 2) << gap;
      // Directions to what is so near are known to the rounding of their ends only.
      EXPECT_LT(length(green.rebuilt(cage, cage.positions) - p), 1e-12 + 1e-15 / gap) << gap;
    }
    const Green on(cage, target);
    for (const double value : on.phi) EXPECT_TRUE(std::isfinite(value));
    for (const double value : on.psi) EXPECT_TRUE(std::isfinite(value));
  }
}

TEST(MeanValueCoordinates, FollowAffineMapsEverywhere) {
  const Surface cage = uneven_cage(5);
  const auto affine = [](const Vec3& p) {
    return Vec3{2 * p[0] + 0.3 * p[1] - 1, 0.2 * p[0] + 0.5 * p[1] + p[2], -p[2] + 0.7 * p[1] + 3};
  };
  std::vector<Vec3> points = points_inside(5);
  points.insert(points.end(), {{3, 1, 2},
                               {-1, -4, 0.2},
                               cage.positions[3],
                               (1.0 / 3) * (cage.positions[cage.faces[4][0]] + cage.positions[cage.faces[4][1]] +
                                            cage.positions[cage.faces[4][2]])});
  std::vector<double> w(cage.vertex_count());
  for (const Vec3& p : points) {
    mean_value_coordinates(cage, p, w);
    EXPECT_NEAR(sum(w), 1, 1e-12);
    Vec3 moved{};
    for (std::size_t i = 0; i < w.size(); ++i) moved = moved + w[i] * affine(cage.positions[i]);
    EXPECT_LT(length(moved - affine(p)), 1e-8) << p[0] << ' ' << p[1] << ' ' << p[2];
  }
}

}  // namespace
}  // namespace eigencast::deform
