// SPDX-License-Identifier: MIT
#include "common/surface/checks/check.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>

#include "common/core/union_find.h"
#include "common/surface/checks/half_edges.h"
#include "common/surface/edge_uses.h"
#include "common/surface/vector.h"

namespace eigencast {
namespace {

constexpr double kNoArea = 1e-14;  // of the squared diagonal

double twice_area(const Vec3& a, const Vec3& b, const Vec3& c) {
  const Vec3 normal = cross(b - a, c - a);
  return std::hypot(normal[0], normal[1], normal[2]);
}

void count_components(const Surface& surface, SurfaceReport& report) {
  const std::size_t n = surface.vertex_count();
  UnionFind vertices(n);
  std::vector<std::uint8_t> referenced(n, 0);
  std::vector<std::uint8_t> connected(n, 0);
  for (const Face& f : surface.faces) {
    for (const std::uint32_t v : f) {
      if (v < n) referenced[v] = 1;
    }
    if (!has_three_corners(f, n)) continue;
    for (const std::uint32_t v : f) connected[v] = 1;
    vertices.join(f[0], f[1]);
    vertices.join(f[0], f[2]);
  }
  for (std::uint32_t v = 0; v < n; ++v) {
    if (connected[v] && vertices.root(v) == v) ++report.components;
    if (!referenced[v]) ++report.unreferenced_vertices;
  }
}

template <typename Key>
std::size_t count_repeats(std::vector<Key>& keys) {
  std::sort(keys.begin(), keys.end());
  return static_cast<std::size_t>(std::distance(std::unique(keys.begin(), keys.end()), keys.end()));
}

std::size_t count_duplicate_vertices(const std::vector<Vec3>& positions) {
  std::vector<std::array<std::uint64_t, 3>> keys;
  keys.reserve(positions.size());
  for (const Vec3& p : positions) {
    // Adding 0 makes -0 and 0 one; bits order NaNs too.
    keys.push_back({std::bit_cast<std::uint64_t>(p[0] + 0.0), std::bit_cast<std::uint64_t>(p[1] + 0.0),
                    std::bit_cast<std::uint64_t>(p[2] + 0.0)});
  }
  return count_repeats(keys);
}

void count_odd_faces(const Surface& surface, SurfaceReport& report) {
  const double diagonal = bounding_box(surface.positions).diagonal();
  const double no_area = kNoArea * diagonal * diagonal;
  std::vector<Face> keys = surface.faces;
  for (Face& f : keys) {
    std::sort(f.begin(), f.end());
    const bool whole = has_three_corners(f, surface.vertex_count());
    const std::vector<Vec3>& p = surface.positions;
    if (!whole || !(twice_area(p[f[0]], p[f[1]], p[f[2]]) / 2 > no_area)) ++report.degenerate_faces;
  }
  report.duplicate_faces = count_repeats(keys);
}

}  // namespace

SurfaceReport check_surface(const Surface& surface) {
  SurfaceReport report;
  report.vertices = surface.vertex_count();
  report.faces = surface.faces.size();
  report.duplicate_vertices = count_duplicate_vertices(surface.positions);
  if (surface.is_point_cloud()) return report;
  count_components(surface, report);
  static_cast<Manifoldness&>(report) = manifoldness(surface.faces, surface.vertex_count());
  count_odd_faces(surface, report);
  return report;
}

std::string text_from_report(const SurfaceReport& report) {
  std::string text = std::to_string(report.vertices) + " vertices";
  if (report.faces == 0) {
    text += ", no faces (point cloud)\n";
  } else {
    text += ", " + std::to_string(report.faces) + " faces, " + std::to_string(report.components) +
            (report.components == 1 ? " component" : " components") + (report.closed() ? ", closed\n" : "\n");
  }
  const auto line = [&text](std::size_t count, const char* what) {
    if (count > 0) text += "  " + std::to_string(count) + " " + what + "\n";
  };
  line(report.boundary_edges, "boundary edges (of one face only)");
  line(report.boundary_loops, "boundary loops");
  line(report.nonmanifold_edges, "non-manifold edges (of three or more faces)");
  line(report.nonmanifold_vertices, "non-manifold vertices (surfaces touch in a point)");
  line(report.misoriented_edges, "edges between faces of opposite orientation");
  line(report.duplicate_vertices, "vertices at the position of an earlier one");
  line(report.unreferenced_vertices, "vertices of no face");
  line(report.degenerate_faces, "faces without area");
  line(report.duplicate_faces, "faces that repeat an earlier one");
  return text;
}

}  // namespace eigencast
