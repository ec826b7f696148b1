// SPDX-License-Identifier: MIT
#include "sender/deform/cage.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cassert>
#include <cmath>
#include <map>
#include <numbers>
#include <numeric>
#include <utility>

#include "common/core/union_find.h"
#include "common/core/worker_team.h"
#include "common/surface/checks/check.h"
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

void turn_outward(Surface& mesh) {
  UnionFind parts(mesh.vertex_count());
  for (const Face& face : mesh.faces) {
    parts.join(face[0], face[1]);
    parts.join(face[0], face[2]);
  }
  std::map<std::uint32_t, double> volumes;  // by part, six times; seen from its lowest vertex
  for (const Face& face : mesh.faces) {
    const std::uint32_t part = parts.root(face[0]);
    const Vec3& origin = mesh.positions[part];
    volumes[part] += dot(mesh.positions[face[0]] - origin,
                         cross(mesh.positions[face[1]] - origin, mesh.positions[face[2]] - origin));
  }
  for (Face& face : mesh.faces) {
    if (volumes[parts.root(face[0])] < 0) std::swap(face[1], face[2]);
  }
}

constexpr std::size_t kMaxWeights = std::size_t{2} << 30 >> 3;
constexpr std::size_t kRowsPerTask = 64;

class CageDeformer final : public Deformer {
 public:
  CageDeformer(Surface cage, CageCoordinates coordinates, LinearMap map)
      : cage_(std::move(cage)), coordinates_(coordinates), map_(std::move(map)) {}
  std::span<const Vec3> handles() const override { return cage_.positions; }
  std::span<const Face> handle_faces() const override { return cage_.faces; }
  const LinearMap* linear_map() const override { return &map_; }
  std::vector<double> controls(std::span<const Vec3> moved) const override {
    assert(moved.size() == cage_.vertex_count());
    std::vector<double> y;
    y.reserve(3 * map_.controls);
    for (const Vec3& p : moved) y.insert(y.end(), p.begin(), p.end());
    if (coordinates_ == CageCoordinates::kMeanValue) return y;
    for (const Vec3& n : stretched_normals(cage_, moved)) y.insert(y.end(), n.begin(), n.end());
    return y;
  }
  std::vector<Vec3> positions(std::span<const Vec3> moved) override { return applied(map_, controls(moved)); }

 private:
  Surface cage_;
  CageCoordinates coordinates_;
  LinearMap map_;
};

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
  const double sum = std::accumulate(w.begin(), w.end(), 0.0);
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

Result<Surface> cage_from_mesh(Surface mesh) {
  if (const auto valid = validate_surface(mesh); !valid) return in_context("cage", valid.error());
  if (mesh.vertex_count() > kMaxCageVertices) {
    return fail(ErrorCode::kTooLarge, "cage: " + std::to_string(mesh.vertex_count()) + " vertices; at most " +
                                          std::to_string(kMaxCageVertices) + ": is this the model itself?");
  }
  const SurfaceReport report = check_surface(mesh);
  std::string wrong;
  if (report.faces == 0) {
    wrong = "it has no faces";
  } else if (report.boundary_edges > 0) {
    wrong = std::to_string(report.boundary_edges) + " edges have one face only: it is not closed";
  } else if (report.nonmanifold_edges > 0) {
    wrong = std::to_string(report.nonmanifold_edges) + " edges have more than two faces";
  } else if (report.misoriented_edges > 0) {
    wrong = "faces on the two sides of " + std::to_string(report.misoriented_edges) + " edges are turned differently";
  } else if (report.degenerate_faces > 0) {
    wrong = std::to_string(report.degenerate_faces) + " faces have no area";
  }
  if (!wrong.empty()) return fail(ErrorCode::kInvalidArgument, "cage: " + wrong);
  turn_outward(mesh);
  return mesh;
}

double winding_number(const Surface& cage, const Vec3& point) {
  double angle = 0;
  for (const Face& face : cage.faces) {
    const Vec3 a = cage.positions[face[0]] - point;
    const Vec3 b = cage.positions[face[1]] - point;
    const Vec3 c = cage.positions[face[2]] - point;
    const double la = length(a), lb = length(b), lc = length(c);
    angle += 2 * std::atan2(dot(a, cross(b, c)), la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb);
  }
  return angle / (4 * std::numbers::pi);
}

Result<std::unique_ptr<Deformer>> cage_deformer(const Surface& model, Surface cage, CageCoordinates coordinates,
                                                const std::function<bool(double)>& progress) {
  const bool is_green = coordinates == CageCoordinates::kGreen;
  const std::size_t n = model.vertex_count(), corners = cage.vertex_count();
  LinearMap map{n, corners + (is_green ? cage.faces.size() : 0), {}};
  if (map.controls > kMaxWeights / n) {
    return fail(ErrorCode::kTooLarge, std::to_string(n) + " vertices in a cage of " + std::to_string(corners) +
                                          " need more than 2 GiB of weights; take a coarser cage");
  }
  map.W.resize(n * map.controls);
  const std::size_t tasks = (n + kRowsPerTask - 1) / kRowsPerTask;
  // In rounds, so that the caller's thread reports progress.
  const std::size_t rounds = std::min<std::size_t>(tasks, 50);
  std::atomic<std::size_t> outside{0}, first_outside{n};
  for (std::size_t round = 0; round < rounds; ++round) {
    if (progress && !progress(static_cast<double>(round) / static_cast<double>(rounds)))
      return fail(ErrorCode::kCancelled, "stopped while the model was bound to its cage");
    const std::size_t first_task = tasks * round / rounds, last_task = tasks * (round + 1) / rounds;
    worker_team().run(last_task - first_task, [&](std::size_t task) {
      const std::size_t begin = (first_task + task) * kRowsPerTask;
      for (std::size_t i = begin; i < std::min(n, begin + kRowsPerTask); ++i) {
        const std::span<double> row(&map.W[i * map.controls], map.controls);
        if (!is_green) {
          mean_value_coordinates(cage, model.positions[i], row);
          continue;
        }
        green_coordinates(cage, model.positions[i], row.first(corners), row.subspan(corners));
        if (winding_number(cage, model.positions[i]) > 0.75) continue;
        ++outside;
        std::size_t known = first_outside;
        while (i < known && !first_outside.compare_exchange_weak(known, i)) {
        }
      }
    });
  }
  if (outside > 0) {
    return fail(ErrorCode::kInvalidArgument,
                std::to_string(outside) + " vertices of the model are not inside the cage, the first is number " +
                    std::to_string(first_outside) + "; use a larger cage, or mean value coordinates");
  }
  return std::unique_ptr<Deformer>(std::make_unique<CageDeformer>(std::move(cage), coordinates, std::move(map)));
}

}  // namespace eigencast::deform
