// SPDX-License-Identifier: MIT
#include "sender/deform/cage.h"

#include <algorithm>
#include <map>
#include <numbers>
#include <numeric>
#include <utility>

#include "common/surface/checks/check.h"
#include "common/surface/vector.h"

namespace eigencast::deform {
namespace {

/// By the lowest vertex of the part.
std::vector<std::uint32_t> parts_of(const Surface& mesh) {
  std::vector<std::uint32_t> parent(mesh.vertex_count());
  std::iota(parent.begin(), parent.end(), 0u);
  const auto root = [&](std::uint32_t v) {
    while (parent[v] != v) v = parent[v] = parent[parent[v]];
    return v;
  };
  for (const Face& face : mesh.faces) {
    for (const std::uint32_t v : face) {
      const std::uint32_t a = root(face[0]), b = root(v);
      parent[std::max(a, b)] = std::min(a, b);
    }
  }
  std::vector<std::uint32_t> parts;
  parts.reserve(mesh.faces.size());
  for (const Face& face : mesh.faces) parts.push_back(root(face[0]));
  return parts;
}

double volume6(const Surface& mesh, const Face& face, const Vec3& origin) {
  return dot(mesh.positions[face[0]] - origin,
             cross(mesh.positions[face[1]] - origin, mesh.positions[face[2]] - origin));
}

void turn_outward(Surface& mesh) {
  const std::vector<std::uint32_t> parts = parts_of(mesh);
  std::map<std::uint32_t, double> volumes;
  for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
    volumes[parts[f]] += volume6(mesh, mesh.faces[f], mesh.positions[parts[f]]);
  }
  for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
    if (volumes[parts[f]] < 0) std::swap(mesh.faces[f][1], mesh.faces[f][2]);
  }
}

}  // namespace

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

}  // namespace eigencast::deform
