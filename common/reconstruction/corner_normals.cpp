// SPDX-License-Identifier: MIT
#include "common/reconstruction/corner_normals.h"

#include <array>
#include <cassert>
#include <cmath>
#include <utility>

#include "common/core/union_find.h"
#include "common/reconstruction/reconstruct.h"

namespace eigencast {
namespace {

/// Cosine: by less no face bends that is known to differ from its neighbour; their normals' rounding does.
constexpr double kLeastBend = 1 - 5e-7;
/// So many groups of a vertex are looked at for the most alike.
constexpr std::ptrdiff_t kMaxSought = 64;
constexpr std::uint32_t kNone = ~std::uint32_t{0};

using Vector = std::array<double, 3>;

double dot(const Vector& a, const Vector& b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/// Of unit length, or zero where the face has no area.
Vector normal_of(const Corners& face, std::span<const float> rest) {
  const auto side = [&](std::size_t corner) {
    Vector v;
    for (std::size_t d = 0; d < 3; ++d)
      v[d] = double{rest[std::size_t{3} * face[corner] + d]} - double{rest[std::size_t{3} * face[0] + d]};
    return v;
  };
  const Vector a = side(1), b = side(2);
  Vector n{a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
  const double length = std::sqrt(dot(n, n));
  for (double& value : n) value = length > 0 ? value / length : 0;
  return n;
}

/// An edge at a vertex, with the first two corners of the faces there.
struct Edge {
  std::uint32_t end, side, a, b, uses;
  bool fits;  ///< The faces run the same way round.
};

}  // namespace

CornerNormals::CornerNormals(const Whole& whole, std::span<const Parting> partings, double cosine)
    : vertices_(whole.vertices) {
  group(whole, partings, cosine);
  if (empty())
    *this = {};
  else
    contract(whole);
}

void CornerNormals::group(const Whole& whole, std::span<const Parting> partings, double cosine) {
  const auto rows = static_cast<std::uint32_t>(whole.map.size());
  const auto parting_of = [&](std::uint32_t v) { return v < partings.size() ? partings[v] : Parting::kNone; };
  std::vector<std::uint32_t> first(std::size_t{rows} + 2), corners;  // those of each vertex with a parting
  for (const Corners& face : whole.faces) {
    for (const std::uint32_t v : face) first[v + 2] += parting_of(v) != Parting::kNone ? 1 : 0;
  }
  for (std::size_t v = 2; v < first.size(); ++v) first[v] += first[v - 1];
  corners.resize(first.back());
  if (corners.empty()) return;
  corners_.reserve(3 * whole.faces.size());
  for (const Corners& face : whole.faces) {
    for (const std::uint32_t v : face) {
      if (parting_of(v) != Parting::kNone) corners[first[v + 1]++] = static_cast<std::uint32_t>(corners_.size());
      corners_.push_back(v);
    }
  }
  UnionFind groups(corners.size());
  std::vector<Vector> normals;
  std::vector<Edge> edges;
  std::vector<std::uint32_t> edge_to(rows, kNone), number(corners.size(), kNone);  // by a group's root
  parts_.resize(vertices_);
  for (std::uint32_t v = 0; v < rows; ++v) {
    const std::uint32_t begin = first[v], end = first[v + 1];
    if (begin == end) continue;
    normals.clear();
    edges.clear();
    for (std::uint32_t i = begin; i < end; ++i) {
      const std::uint32_t face = corners[i] / 3, corner = corners[i] % 3;
      const Corners& ends = whole.faces[face];
      normals.push_back(normal_of(ends, whole.rest));
      if (dot(normals.back(), normals.back()) == 0) continue;
      for (const std::uint32_t side : {1U, 2U}) {  // the face runs away from here, or comes
        std::uint32_t& at = edge_to[ends[(corner + side) % 3]];
        if (at == kNone) {
          at = static_cast<std::uint32_t>(edges.size());
          edges.push_back({ends[(corner + side) % 3], side, i, i, 1, false});
          continue;
        }
        Edge& edge = edges[at];
        edge.fits = ++edge.uses == 2 && edge.side != side;
        edge.b = i;
      }
    }
    const auto bend_of = [&](const Edge& edge) {
      return edge.fits ? dot(normals[edge.a - begin], normals[edge.b - begin]) : -1;
    };
    double limit = cosine, sharpest = 1;
    for (const Edge& edge : edges) {
      edge_to[edge.end] = kNone;
      if (edge.uses > 1) sharpest = std::min(sharpest, bend_of(edge));
    }
    if (parting_of(v) == Parting::kKnown)
      limit = std::max(limit, std::min(std::sqrt(std::max(1 + sharpest, 0.0) / 2), kLeastBend));
    for (const Edge& edge : edges) {
      if (edge.fits && bend_of(edge) > limit) groups.join(edge.a, edge.b);
    }
    bool first_is_taken = false;
    for (std::uint32_t i = begin; i < end; ++i) {
      const Vector& normal = normals[i - begin];
      if (dot(normal, normal) == 0) continue;
      std::uint32_t& mine = number[groups.root(i)];
      if (mine == kNone && !std::exchange(first_is_taken, true)) mine = v;
      if (mine == kNone) {
        mine = vertices_ + static_cast<std::uint32_t>(origins_.size());
        origins_.push_back(v);
        parts_[v] = 1;
      }
      corners_[corners[i]] = mine;
    }
  }
}

/// A group goes on in the one that it meets at a face that vanishes with its vertex; else in the one that looks most
/// like it.
void CornerNormals::contract(const Whole& whole) {
  const auto rows = static_cast<std::uint32_t>(whole.map.size());
  parents_.resize(vertices_ + origins_.size());
  for (std::uint32_t i = 0; i < parents_.size(); ++i) parents_[i] = i;
  std::vector<float> sums(std::size_t{3} * rows), extras(3 * origins_.size());
  area_normals(whole.rest, corners_, *this, sums, extras);
  const auto alike = [&](std::uint32_t a, std::uint32_t b) {
    const auto sum = [&](std::uint32_t i) {
      return i < vertices_ ? &sums[std::size_t{3} * i] : &extras[std::size_t{3} * (i - vertices_)];
    };
    Vector x, y;
    std::copy_n(sum(a), 3, x.begin());
    std::copy_n(sum(b), 3, y.begin());
    return dot(x, y) / std::max(std::sqrt(dot(y, y)), 1e-300);
  };
  std::size_t face = whole.faces.size(), mine = origins_.size(), mine_end = mine;
  for (std::uint32_t v = rows; v-- > whole.base;) {
    const std::uint32_t into = whole.map[v];
    for (mine_end = mine; mine > 0 && origins_[mine - 1] == v;) --mine;
    const std::size_t faces_end = face;
    while (face > 0 && whole.death[face - 1] >= v) --face;
    const auto for_mine = [&](auto&& use) {
      use(v);
      for (std::size_t e = mine; e < mine_end; ++e) use(vertices_ + static_cast<std::uint32_t>(e));
    };
    if (!parts(into)) {
      for_mine([&](std::uint32_t i) { parents_[i] = into; });
      continue;
    }
    for_mine([&](std::uint32_t i) { parents_[i] = kNone; });
    for (std::size_t f = face; f < faces_end; ++f) {
      std::uint32_t from = kNone, to = kNone;
      for (std::size_t corner = 3 * f; corner < 3 * f + 3; ++corner) {
        std::uint32_t i = corners_[corner];
        while (origin(i) > v) i = parents_[i];
        if (origin(i) == v) from = i;
        if (origin(i) == into) to = i;
      }
      if (from != kNone && to != kNone && parents_[from] == kNone) parents_[from] = to;
    }
    const auto others = std::equal_range(origins_.begin(), origins_.end(), into);
    for_mine([&](std::uint32_t i) {
      if (parents_[i] != kNone) return;
      parents_[i] = into;
      for (auto e = others.first; e != others.second && others.second - others.first <= kMaxSought; ++e) {
        const std::uint32_t other = vertices_ + static_cast<std::uint32_t>(e - origins_.begin());
        if (alike(i, other) > alike(i, parents_[i])) parents_[i] = other;
      }
    });
  }
}

void CornerNormals::share(const LevelMorph& level, std::span<float> sums, std::span<float> extras) const {
  const auto sum = [&](std::uint32_t i) {
    return i < vertices_ ? &sums[std::size_t{3} * i] : &extras[std::size_t{3} * (i - vertices_)];
  };
  const auto for_each_of = [&](std::uint32_t v, auto&& use) {
    use(sum(v), sum(parents_[v]), level.weight(v));
    if (!parts(v)) return;
    for (auto e = std::lower_bound(origins_.begin(), origins_.end(), v); e != origins_.end() && *e == v; ++e) {
      const std::uint32_t i = vertices_ + static_cast<std::uint32_t>(e - origins_.begin());
      use(sum(i), sum(parents_[i]), level.weight(v));
    }
  };
  for (std::uint32_t v = level.drawn(); v-- > level.whole();) {
    for_each_of(v, [](const float* own, float* from, float weight) {
      for (std::size_t d = 0; d < 3; ++d) from[d] += (1 - weight) * own[d];
    });
  }
  for (std::uint32_t v = level.whole(); v < level.drawn(); ++v) {
    for_each_of(v, [](float* own, const float* from, float weight) {
      for (std::size_t d = 0; d < 3; ++d) own[d] = weight * own[d] + (1 - weight) * from[d];
    });
  }
}

}  // namespace eigencast
