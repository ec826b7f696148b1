// SPDX-License-Identifier: MIT
#include "common/surface/checks/half_edges.h"

#include <OpenMesh/Core/Mesh/ArrayKernel.hh>
#include <array>
#include <cstdint>
#include <vector>

#include "common/core/union_find.h"
#include "common/surface/edge_uses.h"

namespace eigencast {
namespace {

using HalfEdge = OpenMesh::HalfedgeHandle;
using Edge = std::span<const EdgeUse>;  // by the faces that share it

constexpr std::uint32_t kNone = ~std::uint32_t{0};

OpenMesh::VertexHandle vertex_handle(std::uint32_t vertex) {
  return OpenMesh::VertexHandle(static_cast<int>(vertex));
}
std::size_t index_of(OpenMesh::BaseHandle handle) {
  return static_cast<std::size_t>(handle.idx());
}

/// The faces to turn so that neighbours run along their edge in opposite directions, as far as that is possible.
std::vector<bool> turned_faces(Edge uses, std::size_t face_count) {
  struct Neighbour {
    std::uint32_t face = kNone;
    bool same_direction = false;
  };
  std::vector<std::array<Neighbour, 3>> across(face_count);
  for_each_edge(uses, [&](Edge edge) {
    if (edge.size() != 2) return;
    const bool same = edge[0].upwards == edge[1].upwards;
    across[edge[0].face][edge[0].side] = {edge[1].face, same};
    across[edge[1].face][edge[1].side] = {edge[0].face, same};
  });
  std::vector<bool> seen(face_count), turned(face_count);
  std::vector<std::uint32_t> front;
  for (std::uint32_t first = 0; first < face_count; ++first) {
    if (seen[first]) continue;
    seen[first] = true;
    front.push_back(first);
    while (!front.empty()) {
      const std::uint32_t face = front.back();
      front.pop_back();
      for (const Neighbour& neighbour : across[face]) {
        if (neighbour.face == kNone || seen[neighbour.face]) continue;
        seen[neighbour.face] = true;
        turned[neighbour.face] = turned[face] != neighbour.same_direction;
        front.push_back(neighbour.face);
      }
    }
  }
  return turned;
}

/// The oriented surface, cut where half-edges cannot hold it.
class CutMesh {
 public:
  CutMesh(Edge uses, std::size_t face_count, std::size_t vertex_count) : sides_(3 * face_count) {
    const std::vector<bool> turned = turned_faces(uses, face_count);
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

}  // namespace

Manifoldness manifoldness(std::span<const Face> faces, std::size_t vertex_count) {
  const std::vector<EdgeUse> uses = edge_uses(faces, vertex_count);
  Manifoldness found;
  for_each_edge(std::span(uses), [&](Edge edge) {
    if (edge.size() == 1) ++found.boundary_edges;
    if (edge.size() > 2) ++found.nonmanifold_edges;
    if (edge.size() == 2 && edge[0].upwards == edge[1].upwards) ++found.misoriented_edges;
  });
  const CutMesh cut(uses, faces.size(), vertex_count);
  found.boundary_loops = count_loops(cut, uses);
  found.nonmanifold_vertices = count_vertices_of_several_fans(cut, uses, vertex_count);
  return found;
}

}  // namespace eigencast
