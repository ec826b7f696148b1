// SPDX-License-Identifier: MIT
#include "sender/deform/coordinates.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <numbers>

#include "common/surface/vector.h"

namespace eigencast::deform {
namespace {

constexpr double kTiny = 1e-15;  // of the lengths around: below, a point lies on an edge or a vertex

/// ln((a + b + l) / (a + b - l)) / l for a point at distances a, b from the ends of an edge of length l. It grows
/// slower than any power as the point nears the edge, and is always multiplied by a distance that vanishes there.
double edge_potential(double a, double b, double l) {
  const double rest = std::max(a + b - l, kTiny * (a + b + l));
  return std::log((a + b + l) / rest) / l;
}

}  // namespace

void green_coordinates(const Surface& cage, const Vec3& point, std::span<double> phi, std::span<double> psi) {
  assert(phi.size() == cage.vertex_count() && psi.size() == cage.faces.size());
  constexpr double kOverFourPi = 1 / (4 * std::numbers::pi);
  std::fill(phi.begin(), phi.end(), 0.0);
  for (std::size_t f = 0; f < cage.faces.size(); ++f) {
    const Face& face = cage.faces[f];
    std::array<Vec3, 3> e;
    std::array<double, 3> r;
    for (std::size_t k = 0; k < 3; ++k) {
      e[k] = cage.positions[face[k]] - point;
      r[k] = length(e[k]);
    }
    const Vec3 area2 = cross(e[1] - e[0], e[2] - e[0]);
    const double twice_area = length(area2);
    const Vec3 n = (1 / twice_area) * area2;
    const double height = dot(e[0], n);
    const double solid_angle =
        2 * std::atan2(dot(e[0], cross(e[1], e[2])),
                       r[0] * r[1] * r[2] + dot(e[0], e[1]) * r[2] + dot(e[0], e[2]) * r[1] + dot(e[1], e[2]) * r[0]);
    double potential = -height * solid_angle;
    Vec3 dipole = -solid_angle * n;
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t a = (k + 1) % 3, b = (k + 2) % 3;
      const Vec3 edge = e[b] - e[a];
      const double l = edge_potential(r[a], r[b], length(edge));
      potential += l * dot(cross(e[a], e[b]), n);
      dipole = dipole - l * cross(n, edge);
    }
    psi[f] = potential * kOverFourPi;
    for (std::size_t k = 0; k < 3; ++k) {
      phi[face[k]] -= dot(dipole, cross(e[(k + 1) % 3], e[(k + 2) % 3])) / twice_area * kOverFourPi;
    }
  }
}

void mean_value_coordinates(const Surface& cage, const Vec3& point, std::span<double> w) {
  assert(w.size() == cage.vertex_count());
  std::fill(w.begin(), w.end(), 0.0);
  std::vector<Vec3> directions(cage.vertex_count());
  std::vector<double> distances(cage.vertex_count());
  for (std::size_t v = 0; v < cage.vertex_count(); ++v) {
    const Vec3 to = cage.positions[v] - point;
    distances[v] = length(to);
    if (distances[v] < kTiny * (1 + length(point))) {
      w[v] = 1;
      return;
    }
    directions[v] = (1 / distances[v]) * to;
  }
  constexpr double kFlat = 1e-9;
  for (const Face& face : cage.faces) {
    std::array<double, 3> angle, c, s;
    for (std::size_t k = 0; k < 3; ++k) {
      const double chord = length(directions[face[(k + 1) % 3]] - directions[face[(k + 2) % 3]]);
      angle[k] = 2 * std::asin(std::min(1.0, chord / 2));
    }
    const double half = (angle[0] + angle[1] + angle[2]) / 2;
    if (std::numbers::pi - half < kFlat) {
      // The point lies on the face: the coordinates within it.
      std::fill(w.begin(), w.end(), 0.0);
      double sum = 0;
      for (std::size_t k = 0; k < 3; ++k) {
        w[face[k]] = std::sin(angle[k]) * distances[face[(k + 1) % 3]] * distances[face[(k + 2) % 3]];
        sum += w[face[k]];
      }
      for (std::size_t k = 0; k < 3; ++k) w[face[k]] /= sum;
      return;
    }
    const double turn = dot(directions[face[0]], cross(directions[face[1]], directions[face[2]])) < 0 ? -1 : 1;
    bool in_plane = false;
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t a = (k + 1) % 3, b = (k + 2) % 3;
      c[k] = 2 * std::sin(half) * std::sin(half - angle[k]) / (std::sin(angle[a]) * std::sin(angle[b])) - 1;
      s[k] = turn * std::sqrt(std::max(0.0, 1 - c[k] * c[k]));
      in_plane |= std::abs(s[k]) < kFlat || !std::isfinite(c[k]);
    }
    if (in_plane) continue;  // seen edge-on, from outside of it: no share
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t a = (k + 1) % 3, b = (k + 2) % 3;
      w[face[k]] += (angle[k] - c[a] * angle[b] - c[b] * angle[a]) / (distances[face[k]] * std::sin(angle[a]) * s[b]);
    }
  }
  double sum = 0;
  for (const double weight : w) sum += weight;
  for (double& weight : w) weight /= sum;
}

std::vector<Vec3> stretched_normals(const Surface& rest, std::span<const Vec3> moved) {
  assert(moved.size() == rest.vertex_count());
  std::vector<Vec3> normals;
  normals.reserve(rest.faces.size());
  for (const Face& f : rest.faces) {
    const Vec3 u = rest.positions[f[1]] - rest.positions[f[0]], v = rest.positions[f[2]] - rest.positions[f[0]];
    const Vec3 p = moved[f[1]] - moved[f[0]], q = moved[f[2]] - moved[f[0]];
    const double squared = dot(p, p) * dot(v, v) - 2 * dot(p, q) * dot(u, v) + dot(q, q) * dot(u, u);
    // sqrt(8) times the area is sqrt(2) times the cross product.
    const double stretch = std::sqrt(std::max(0.0, squared) / 2) / length(cross(u, v));
    normals.push_back(stretch * unit(cross(p, q)));
  }
  return normals;
}

}  // namespace eigencast::deform
