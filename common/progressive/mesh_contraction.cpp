// SPDX-License-Identifier: MIT
#include <algorithm>
#include <cmath>

#include "common/core/union_find.h"
#include "common/progressive/contraction.h"

namespace eigencast::progressive {
namespace {

constexpr double kBoundaryWeight = 10;
constexpr double kMinNormalAgreement = 0.2;
constexpr double kMinShape = 0.02;  // Height over length of a face.
constexpr std::size_t kMaxMeshNeighbours = 24;
constexpr std::uint32_t kSmallComponent = 4;  // Vertices of the smallest closed surface.

enum class Rules {
  kTopology,  ///< The surface's topology, its boundary, and the side that faces show.
  kSides,     ///< Only the side that faces show.
  kNone,
};

Vec3 area_vector(std::span<const Vec3> x, const Face& face) {
  return cross(x[face[1]] - x[face[0]], x[face[2]] - x[face[0]]);
}

double longest_edge2(std::span<const Vec3> x, const Face& face) {
  const Vec3 &a = x[face[0]], &b = x[face[1]], &c = x[face[2]];
  return std::max({squared_distance(a, b), squared_distance(b, c), squared_distance(c, a)});
}

class MeshContraction : Contraction {
 public:
  MeshContraction(std::span<const std::vector<Vec3>> poses, std::span<const Face> faces,
                  std::span<const std::pair<std::uint32_t, std::uint32_t>> seams, const std::atomic<bool>& unwanted)
      : Contraction(poses.front().size(), unwanted),
        poses_(poses),
        x_(poses.front()),
        seams_(seams),
        faces_(faces.begin(), faces.end()),
        around_(x_.size()),
        quadrics_(poses.size() * x_.size()),
        components_(x_.size()),
        mark_(x_.size()),
        slot_(x_.size()) {
    for (std::uint32_t f = 0; f < faces_.size(); ++f) {
      for (const std::uint32_t v : faces_[f]) around_[v].push_back(f);
    }
  }

  std::vector<Step> run() {
    for (std::uint32_t v = 0; v < x_.size(); ++v) {
      if (around_[v].empty()) remove(v, kNoTarget);
    }
    weld();
    find_components();
    for (std::size_t pose = 0; pose < poses_.size(); ++pose) make_quadrics(pose);
    const std::size_t useful = alive_count_;
    contract_all(Rules::kTopology, wanted_base());
    // A base that is larger because of its topology is right only as long as it is small.
    const std::size_t tolerable = std::max<std::size_t>(64, useful / 50);
    contract_all(Rules::kSides, tolerable);
    contract_all(Rules::kNone, tolerable);
    return std::move(steps_);
  }

 private:
  struct Neighbour {
    std::uint32_t vertex;
    std::uint32_t faces;  ///< How many faces share the edge.
  };

  // Contracts vertices on boundaries that lie at the same position: seams, or corners of a soup of triangles. Nothing
  // visible changes, and the result is a surface.
  void weld() {
    const auto first = first_at_position(x_);
    std::vector<bool> on_boundary(x_.size());
    for (std::uint32_t v = 0; v < x_.size(); ++v) {
      if (!alive_[v]) continue;
      gather_neighbours(v, around_from_);
      on_boundary[v] =
          std::any_of(around_from_.begin(), around_from_.end(), [](const Neighbour& w) { return w.faces == 1; });
    }
    std::vector<std::uint32_t> kept(x_.size(), kNoTarget);
    for (std::uint32_t v = 0; v < x_.size(); ++v) {
      // A target may have lost its last face when one of its neighbours was welded.
      if (!alive_[v] || !on_boundary[v]) continue;
      std::uint32_t& target = kept[first[v]];
      if (target == kNoTarget || !alive_[target]) {
        target = v;
      } else if (together_in_all_poses(v, target)) {
        contract(v, target);
      }
    }
  }

  void find_components() {
    for (std::uint32_t v = 0; v < x_.size(); ++v) {
      for (const std::uint32_t f : around_[v]) {
        for (const std::uint32_t w : faces_[f]) components_.join(v, w);
      }
    }
    left_in_.assign(x_.size(), 0);
    area_of_.assign(x_.size(), 0);
    std::size_t components = 0;
    for (std::uint32_t v = 0; v < x_.size(); ++v) {
      if (alive_[v] && left_in_[component_of(v)]++ == 0) ++components;
    }
    many_components_ = components > 1;
  }

  void make_quadrics(std::size_t pose) {
    const std::span<const Vec3> x = poses_[pose];
    for (std::uint32_t u = 0; u < x.size(); ++u) {
      Quadric& Q = quadric(pose, u);
      for (const std::uint32_t f : around_[u]) {
        const Vec3 normal = area_vector(x, faces_[f]);
        const double twice_area = length(normal);
        if (twice_area <= 0) continue;
        Q.add_plane(unit(normal), x[u], twice_area / 6);
        Q.area += twice_area / 6;
        if (pose == 0) area_of_[component_of(u)] += twice_area / 6;
      }
      // Edges that do not lie between two faces, and seams, hold their line by planes across it.
      gather_neighbours(u, around_from_);
      for (const Neighbour& v : around_from_) {
        if (v.faces == 2 &&
            !std::binary_search(seams_.begin(), seams_.end(), std::pair(std::min(u, v.vertex), std::max(u, v.vertex))))
          continue;
        const Vec3 edge = x[v.vertex] - x[u];
        for (const std::uint32_t f : around_[u]) {
          if (!has(f, v.vertex)) continue;
          const Vec3 across = cross(edge, area_vector(x, faces_[f]));
          if (length(across) > 0) Q.add_plane(unit(across), x[u], kBoundaryWeight * dot(edge, edge) / 2);
        }
      }
    }
  }

  /// The mean over the poses (Mohr & Gleicher 2003, "Deformation sensitive decimation").
  double cost(std::uint32_t u, std::uint32_t v) const {
    double sum = 0;
    for (std::size_t pose = 0; pose < poses_.size(); ++pose) {
      const auto& x = poses_[pose];
      const Quadric* Q = &quadrics_[pose * x.size()];
      sum += contraction_cost(Q[u], Q[v], x[u], x[v]);
    }
    return sum / static_cast<double>(poses_.size());
  }

  bool together_in_all_poses(std::uint32_t u, std::uint32_t v) const {
    return std::all_of(poses_.begin(), poses_.end(), [&](const auto& x) { return x[u] == x[v]; });
  }

  void contract_all(Rules rules, std::size_t goal) {
    rules_ = rules;
    // A contraction can make another legal two edges away, which is not considered again: hence the rounds.
    for (bool progress = true; progress && alive_count_ > goal && !unwanted_;) {
      queue_ = {};
      for (std::uint32_t v = 0; v < x_.size() && !unwanted_; ++v) {
        if (alive_[v]) consider(v);
      }
      const std::size_t before = alive_count_;
      contract_queue(goal, [this](const Candidate& next) { make(next); });
      progress = before - alive_count_ > alive_count_ / 256;
    }
  }

  void make(const Candidate& next) {
    // Faces further away have changed since: what was legal may no longer be.
    gather_neighbours(next.from, around_from_);
    if (!is_legal(next.from, next.to)) {
      consider(next.from);
      return;
    }
    contract(next.from, next.to);
    if (!alive_[next.to]) return;
    gather_neighbours(next.to, around_both_);
    consider(next.to);
    for (const Neighbour& w : around_both_) consider(w.vertex);
  }

  // Puts the cheapest legal contraction of u in the queue, instead of its earlier one.
  void consider(std::uint32_t u) {
    ++version_[u];
    gather_neighbours(u, around_from_);
    if (has_too_many_neighbours()) return;
    choices_.clear();
    for (const Neighbour& v : around_from_) {
      choices_.push_back({cost(u, v.vertex), u, v.vertex, version_[u]});
    }
    std::sort(choices_.begin(), choices_.end(),
              [](const Candidate& a, const Candidate& b) { return a.cost != b.cost ? a.cost < b.cost : a.to < b.to; });
    for (Candidate& choice : choices_) {
      if (!is_legal(u, choice.to)) continue;
      if (in_small_component(u)) {
        // The component goes as a whole: all of its area by about its size.
        const double area = area_of_[component_of(u)];
        choice.cost = std::max(choice.cost, area * area);
      }
      queue_.push(choice);
      return;
    }
  }

  /// Whether no contraction of a vertex with the neighbours `around_from_` is legal: asking one by one takes the hub of
  /// a wheel of thousands of faces hours.
  bool has_too_many_neighbours() const {
    if (rules_ != Rules::kTopology || around_from_.size() <= kMaxMeshNeighbours + 4) return false;
    const auto most = std::max_element(around_from_.begin(), around_from_.end(),
                                       [](const Neighbour& a, const Neighbour& b) { return a.faces < b.faces; });
    return around_from_.size() > kMaxMeshNeighbours + 2 + most->faces;
  }

  void contract(std::uint32_t u, std::uint32_t v) {
    remove(u, v);
    const std::vector<std::uint32_t> moved = std::move(around_[u]);
    around_[u].clear();
    for (const std::uint32_t f : moved) {
      if (has(f, v)) {
        for (const std::uint32_t w : faces_[f]) std::erase(around_[w], f);
      } else {
        *std::find(faces_[f].begin(), faces_[f].end(), u) = v;
        around_[v].push_back(f);
      }
    }
    for (std::size_t pose = 0; pose < poses_.size(); ++pose) quadric(pose, v) += quadric(pose, u);
    // Corners that have lost their last face are not seen any more: they must not count among the first N vertices.
    for (const std::uint32_t f : moved) {
      for (const std::uint32_t w : faces_[f]) {
        if (alive_[w] && around_[w].empty()) remove(w, kNoTarget);
      }
    }
  }

  void remove(std::uint32_t u, std::uint32_t to) {
    Contraction::remove(u, to);
    if (!left_in_.empty()) --left_in_[component_of(u)];
  }

  void gather_neighbours(std::uint32_t u, std::vector<Neighbour>& neighbours) {
    ++stamp_;
    neighbours.clear();
    for (const std::uint32_t f : around_[u]) {
      for (const std::uint32_t v : faces_[f]) {
        if (v == u) continue;
        if (mark_[v] != stamp_) {
          mark_[v] = stamp_;
          slot_[v] = static_cast<std::uint32_t>(neighbours.size());
          neighbours.push_back({v, 0});
        }
        ++neighbours[slot_[v]].faces;
      }
    }
  }

  /// REQUIRES: `around_from_` are the neighbours of u.
  bool is_legal(std::uint32_t u, std::uint32_t v) {
    const auto to =
        std::find_if(around_from_.begin(), around_from_.end(), [&](const Neighbour& w) { return w.vertex == v; });
    if (to == around_from_.end()) return false;
    if (rules_ == Rules::kNone || in_small_component(u)) return true;
    if (rules_ == Rules::kTopology && !keeps_topology(u, *to)) return false;
    return std::all_of(poses_.begin(), poses_.end(), [&](const auto& x) { return keeps_sides(x, u, v); });
  }

  // The link condition (Dey, Edelsbrunner, Guha, Nekhayev 1999, "Topology preserving edge contraction"), and that
  // nothing vanishes.
  bool keeps_topology(std::uint32_t u, const Neighbour& to) {
    const std::uint32_t v = to.vertex;
    const auto& around_u = around_from_;
    const bool u_on_rim =
        std::any_of(around_u.begin(), around_u.end(), [](const Neighbour& w) { return w.faces != 2; });
    if (u_on_rim && to.faces == 2) return false;

    gather_neighbours(v, around_to_);  // Leaves v's neighbours marked.
    std::uint32_t shared = 0;
    for (const Neighbour& w : around_u) {
      if (mark_[w.vertex] != stamp_) continue;
      ++shared;
      if (around_[w.vertex].size() < 2) return false;
    }
    if (shared != to.faces) return false;
    if (around_[v].size() + around_[u].size() < 2 * to.faces + 1) return false;
    if (around_u.size() + around_to_.size() > kMaxMeshNeighbours + 2 + shared && around_u.size() > 2 + shared)
      return false;

    // The edge opposite u in a face must not be one opposite v: the two faces would become one.
    for (const std::uint32_t f : around_[u]) {
      if (has(f, v)) continue;
      std::uint32_t others[2] = {};
      std::size_t count = 0;
      for (const std::uint32_t w : faces_[f]) {
        if (w != u) others[count++] = w;
      }
      if (mark_[others[0]] != stamp_ || mark_[others[1]] != stamp_) continue;
      for (const std::uint32_t g : around_[v]) {
        if (has(g, others[0]) && has(g, others[1])) return false;
      }
    }
    return true;
  }

  bool keeps_sides(std::span<const Vec3> x, std::uint32_t u, std::uint32_t v) const {
    for (const std::uint32_t f : around_[u]) {
      if (has(f, v)) continue;
      Face moved = faces_[f];
      *std::find(moved.begin(), moved.end(), u) = v;
      const Vec3 before = area_vector(x, faces_[f]);
      const double before2 = dot(before, before);
      if (before2 <= 0) continue;
      const Vec3 after = area_vector(x, moved);
      const double after2 = dot(after, after);
      if (dot(before, after) <= kMinNormalAgreement * std::sqrt(before2 * after2)) return false;
      // Needles show as noise in the normals: none is made, though one that is there may become a better one.
      const double shape = std::sqrt(after2) / longest_edge2(x, moved);
      if (shape < kMinShape && shape < std::sqrt(before2) / longest_edge2(x, faces_[f])) return false;
    }
    return true;
  }

  std::uint32_t component_of(std::uint32_t u) { return components_.root(u); }
  bool in_small_component(std::uint32_t u) { return many_components_ && left_in_[component_of(u)] <= kSmallComponent; }
  bool has(std::uint32_t f, std::uint32_t v) const {
    return faces_[f][0] == v || faces_[f][1] == v || faces_[f][2] == v;
  }
  Quadric& quadric(std::size_t pose, std::uint32_t u) { return quadrics_[pose * x_.size() + u]; }

  std::span<const std::vector<Vec3>> poses_;
  std::span<const Vec3> x_;  ///< At rest: poses_[0].
  std::span<const std::pair<std::uint32_t, std::uint32_t>> seams_;
  std::vector<Face> faces_;                         ///< Corners as they are now.
  std::vector<std::vector<std::uint32_t>> around_;  ///< Living faces of each vertex.
  std::vector<Quadric> quadrics_;                   ///< Pose by pose.
  Rules rules_ = Rules::kTopology;

  bool many_components_ = false;
  UnionFind components_;
  std::vector<std::uint32_t> left_in_;  ///< Living vertices, at the root.
  std::vector<double> area_of_;         ///< At the root.

  std::vector<std::uint32_t> mark_, slot_;
  std::uint32_t stamp_ = 0;
  std::vector<Neighbour> around_from_, around_to_, around_both_;
  std::vector<Candidate> choices_;
};

}  // namespace

std::vector<Step> contract_mesh(std::span<const std::vector<Vec3>> poses, std::span<const Face> faces,
                                std::span<const std::pair<std::uint32_t, std::uint32_t>> seams,
                                const std::atomic<bool>& unwanted) {
  return MeshContraction(poses, faces, seams, unwanted).run();
}

}  // namespace eigencast::progressive
