// SPDX-License-Identifier: MIT
#include "common/surface/checks/check.h"

#include <OpenMesh/Core/Mesh/ArrayKernel.hh>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include "common/core/union_find.h"
#include "common/surface/checks/orientation.h"
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

using HalfEdge = OpenMesh::HalfedgeHandle;
using Edge = std::span<const EdgeUse>;  // by the faces that share it

constexpr std::uint32_t kNone = ~std::uint32_t{0};

OpenMesh::VertexHandle vertex_handle(std::uint32_t vertex) {
  return OpenMesh::VertexHandle(static_cast<int>(vertex));
}
std::size_t index_of(OpenMesh::BaseHandle handle) {
  return static_cast<std::size_t>(handle.idx());
}

class CutMesh {
 public:
  CutMesh(Edge uses, std::size_t face_count, std::size_t vertex_count) : sides_(3 * face_count) {
    const std::vector<bool> turned = oriented_patches(uses, face_count).turned;
    mesh_.reserve(vertex_count, uses.size() / 2, face_count);
    mesh_.resize(vertex_count, 0, 0);
    for_each_edge(uses, [&](Edge edge) {
      const auto is_upwards = [&](const EdgeUse& use) { return use.upwards != turned[use.face]; };
      const bool joined = edge.size() == 2 && is_upwards(edge[0]) != is_upwards(edge[1]);
      for (const EdgeUse& use : edge) {
        const OpenMesh::VertexHandle low = vertex_handle(use.low), high = vertex_handle(use.high);
        sides_[3 * use.face + use.side] = joined && &use != edge.data() ? mesh_.opposite_halfedge_handle(side(edge[0]))
                                          : is_upwards(use)             ? mesh_.new_edge(low, high)
                                                                        : mesh_.new_edge(high, low);
      }
    });
    for (std::size_t f = 0; f < face_count; ++f) {
      if (!sides_[3 * f].is_valid()) continue;
      const OpenMesh::FaceHandle face = mesh_.new_face();
      for (std::size_t k = 0; k < 3; ++k) {
        mesh_.set_face_handle(sides_[3 * f + k], face);
        mesh_.set_next_halfedge_handle(sides_[3 * f + k], sides_[3 * f + (k + (turned[f] ? 2 : 1)) % 3]);
      }
    }
    link_boundary();
  }

  const OpenMesh::ArrayKernel& half_edges() const { return mesh_; }
  HalfEdge side(const EdgeUse& use) const { return sides_[3 * use.face + use.side]; }
  /// The half-edge of a face's side, or its opposite, that leaves the edge's lower or higher vertex.
  HalfEdge leaving(const EdgeUse& use, std::uint32_t vertex) const {
    const HalfEdge half = side(use);
    return mesh_.from_vertex_handle(half) == vertex_handle(vertex) ? half : mesh_.opposite_halfedge_handle(half);
  }

 private:
  /// Along each fan, from the half-edge without a face that enters its vertex to the one that leaves it.
  void link_boundary() {
    for (std::size_t i = 0; i < mesh_.n_halfedges(); ++i) {
      const HalfEdge entering(static_cast<int>(i));
      if (!mesh_.is_boundary(entering)) continue;
      HalfEdge next = mesh_.opposite_halfedge_handle(entering);
      while (!mesh_.is_boundary(next)) next = mesh_.ccw_rotated_halfedge_handle(next);
      mesh_.set_next_halfedge_handle(entering, next);
    }
  }

  OpenMesh::ArrayKernel mesh_;
  std::vector<HalfEdge> sides_;  ///< 3 of each face.
};

std::size_t count_loops(const CutMesh& cut, Edge uses) {
  const OpenMesh::ArrayKernel& mesh = cut.half_edges();
  std::vector<bool> seen(mesh.n_halfedges());
  std::size_t loops = 0;
  for_each_edge(uses, [&](Edge edge) {
    HalfEdge half = mesh.opposite_halfedge_handle(cut.side(edge[0]));
    if (edge.size() > 1 || seen[index_of(half)]) return;
    ++loops;
    for (; !seen[index_of(half)]; half = mesh.next_halfedge_handle(half)) seen[index_of(half)] = true;
  });
  return loops;
}

std::size_t count_vertices_of_several_fans(const CutMesh& cut, Edge uses, std::size_t vertex_count) {
  const OpenMesh::ArrayKernel& mesh = cut.half_edges();
  std::vector<std::uint32_t> fan_of(mesh.n_halfedges(), kNone);  // of each half-edge, round the vertex that it leaves
  std::vector<std::size_t> vertex_of;                            // of each fan
  for (std::size_t i = 0; i < fan_of.size(); ++i) {
    HalfEdge half(static_cast<int>(i));
    if (fan_of[i] != kNone) continue;
    const auto fan = static_cast<std::uint32_t>(vertex_of.size());
    vertex_of.push_back(index_of(mesh.from_vertex_handle(half)));
    for (; fan_of[index_of(half)] == kNone; half = mesh.ccw_rotated_halfedge_handle(half)) fan_of[index_of(half)] = fan;
  }
  UnionFind fans(vertex_of.size());
  for_each_edge(uses, [&](Edge edge) {
    if (edge.size() == 2 && cut.side(edge[1]) == mesh.opposite_halfedge_handle(cut.side(edge[0]))) return;  // not cut
    for (const std::uint32_t end : {edge[0].low, edge[0].high}) {
      for (const EdgeUse& use : edge.subspan(1)) {
        fans.join(fan_of[index_of(cut.leaving(edge[0], end))], fan_of[index_of(cut.leaving(use, end))]);
      }
    }
  });
  std::vector<std::uint8_t> count(vertex_count, 0);
  std::size_t several = 0;
  for (std::uint32_t fan = 0; fan < vertex_of.size(); ++fan) {
    if (fans.root(fan) != fan) continue;
    std::uint8_t& fans_here = count[vertex_of[fan]];
    if (fans_here == 1) ++several;
    if (fans_here < 2) ++fans_here;
  }
  return several;
}

// By half-edges (OpenMesh's kernel, docs/adr/0007). Faces are turned until neighbours have one orientation; then the
// surface is cut where half-edges cannot hold it: along edges of three or more faces, and a seam of each part that
// cannot be oriented. Faces without three corners are left out; a cut edge joins fans, too. O(F log F).
void count_manifold_faults(const Surface& surface, SurfaceReport& report) {
  const std::size_t n = surface.vertex_count(), F = surface.faces.size();
  const std::vector<EdgeUse> uses = edge_uses(surface.faces, n);
  for_each_edge(std::span(uses), [&](Edge edge) {
    if (edge.size() == 1) ++report.boundary_edges;
    if (edge.size() > 2) ++report.nonmanifold_edges;
    if (edge.size() == 2 && edge[0].upwards == edge[1].upwards) ++report.misoriented_edges;
  });
  const CutMesh cut(uses, F, n);
  report.boundary_loops = count_loops(cut, uses);
  report.nonmanifold_vertices = count_vertices_of_several_fans(cut, uses, n);
}

}  // namespace

SurfaceReport check_surface(const Surface& surface) {
  SurfaceReport report;
  report.vertices = surface.vertex_count();
  report.faces = surface.faces.size();
  report.duplicate_vertices = count_duplicate_vertices(surface.positions);
  if (surface.is_point_cloud()) return report;
  count_components(surface, report);
  count_manifold_faults(surface, report);
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
