// SPDX-License-Identifier: MIT
#include "common/spectral/intrinsic_triangles.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <functional>
#include <utility>

#include "common/surface/edge_uses.h"

namespace eigencast {
namespace {

constexpr double kNotDelaunay = -1e-9;  // sum of the cotangents opposite to an edge
constexpr std::size_t kMaxFlips = 30;   // per edge, so that rounding cannot cycle for ever

/// Sorts the faces of an edge by angle around it.
void sort_around(std::span<EdgeUse> edge, std::span<const Vec3> positions, std::span<const Face> faces) {
  const auto at = [&](std::uint32_t v) { return Eigen::Vector3d(positions[v].data()); };
  const Eigen::Vector3d foot = at(edge[0].low), axis = (at(edge[0].high) - foot).normalized();
  const auto outwards = [&](const EdgeUse& use) -> Eigen::Vector3d {
    const Eigen::Vector3d e = at(faces[use.face][(use.side + 2) % 3]) - foot;
    return e - axis.dot(e) * axis;
  };
  const Eigen::Vector3d u = outwards(edge[0]), v = axis.cross(u);
  std::vector<std::pair<double, EdgeUse>> by_angle;
  for (const EdgeUse& use : edge) {
    const Eigen::Vector3d e = outwards(use);
    by_angle.emplace_back(std::atan2(v.dot(e), u.dot(e)), use);
  }
  std::stable_sort(by_angle.begin(), by_angle.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  for (std::size_t i = 0; i < edge.size(); ++i) edge[i] = by_angle[i].second;
}

/// Triangles by their sides: side 3 t + k of triangle t runs from its corner k to the next.
class Cover {
 public:
  Cover(std::span<const Vec3> positions, std::span<const Face> faces, std::span<const EdgeLengths> lengths) {
    for (std::size_t f = 0; f < faces.size(); ++f) {
      const auto& [a, b, c] = faces[f];
      const auto& [bc, ca, ab] = lengths[f];
      from_.insert(from_.end(), {a, b, c, a, c, b});  // the front, and the back, which runs the other way
      length_.insert(length_.end(), {ab, bc, ca, ca, bc, ab});
    }
    twin_.resize(from_.size());
    std::vector<EdgeUse> uses = edge_uses(faces, positions.size());
    for_each_edge(std::span(uses), [&](std::span<EdgeUse> edge) {
      if (edge.size() > 2) sort_around(edge, positions, faces);
      for (std::size_t i = 0; i < edge.size(); ++i) {
        const std::uint32_t here = side_of(edge[i], true), there = side_of(edge[(i + 1) % edge.size()], false);
        twin_[here] = there;
        twin_[there] = here;
      }
    });
  }

  std::size_t flip_to_delaunay() {
    std::vector<std::uint32_t> waiting(from_.size());
    for (std::uint32_t side = 0; side < waiting.size(); ++side) waiting[side] = side;
    const std::size_t max_flips = kMaxFlips * from_.size() / 2;
    std::size_t flips = 0;
    while (!waiting.empty() && flips < max_flips) {
      const std::uint32_t side = waiting.back(), twin = twin_[side];
      waiting.pop_back();
      if (cotangent(side) + cotangent(twin) >= kNotDelaunay || !flip(side)) continue;
      ++flips;
      for (const std::uint32_t triangle : {side / 3, twin / 3}) {
        for (std::uint32_t k = 0; k < 3; ++k) waiting.push_back(3 * triangle + k);
      }
    }
    return flips;
  }

  IntrinsicTriangles triangles(std::size_t flips) const {
    IntrinsicTriangles result{{}, {}, flips};
    for (std::size_t s = 0; s < from_.size(); s += 3) {
      result.faces.push_back({from_[s], from_[s + 1], from_[s + 2]});
      result.lengths.push_back({length_[s + 1], length_[s + 2], length_[s]});
    }
    return result;
  }

 private:
  /// The side along the edge of the face's triangle that faces larger angles about it, or smaller ones.
  static std::uint32_t side_of(const EdgeUse& use, bool to_larger) {
    const bool front = use.upwards == to_larger;
    return front ? 6 * use.face + use.side : 6 * use.face + 3 + (2 - use.side);
  }
  static std::uint32_t next(std::uint32_t side) { return side % 3 == 2 ? side - 2 : side + 1; }

  double area(std::uint32_t side) const {
    return area_from_lengths({length_[side], length_[next(side)], length_[next(next(side))]});
  }
  /// The cotangent of the angle opposite to the side.
  double cotangent(std::uint32_t side) const {
    const double a = length_[side], b = length_[next(side)], c = length_[next(next(side))], A = area(side);
    return A > 0 ? (b * b + c * c - a * a) / (4 * A) : 0;
  }

  /// The corner opposite to a side, with that side from (0, 0) along x.
  std::array<double, 2> opposite(std::uint32_t side) const {
    const double a = length_[side], b = length_[next(side)], c = length_[next(next(side))];
    return {(a * a + c * c - b * b) / (2 * a), 2 * area(side) / a};
  }

  /// Replaces the edge a b of the triangles a b c and b a d by c d. False where that gives a degenerate triangle.
  bool flip(std::uint32_t ab) {
    const std::uint32_t ba = twin_[ab];
    if (ab / 3 == ba / 3) return false;
    const std::uint32_t bc = next(ab), ca = next(bc), ad = next(ba), db = next(ad);
    const auto [cx, cy] = opposite(ab);
    const auto [dx, dy] = opposite(ba);  // from b's end, turned half round
    const double cd = std::hypot(length_[ab] - dx - cx, cy + dy);
    if (!(area_from_lengths({length_[ca], length_[ad], cd}) > 0) ||
        !(area_from_lengths({length_[db], length_[bc], cd}) > 0))
      return false;
    const std::uint32_t first = ab - ab % 3, second = ba - ba % 3;  // now c a d and d b c
    const std::array<std::uint32_t, 4> old = {ca, ad, db, bc}, fresh = {first, first + 1, second, second + 1};
    const std::array<std::uint32_t, 4> corner = {from_[ca], from_[ad], from_[db], from_[bc]};
    std::array<double, 4> length{};
    std::array<std::uint32_t, 4> twin{};
    for (std::size_t i = 0; i < 4; ++i) {
      length[i] = length_[old[i]];
      const auto moved = std::find(old.begin(), old.end(), twin_[old[i]]);
      twin[i] = moved == old.end() ? twin_[old[i]] : fresh[static_cast<std::size_t>(moved - old.begin())];
    }
    for (std::size_t i = 0; i < 4; ++i) {
      from_[fresh[i]] = corner[i];
      length_[fresh[i]] = length[i];
      twin_[fresh[i]] = twin[i];
      twin_[twin[i]] = fresh[i];
    }
    from_[first + 2] = corner[2];
    from_[second + 2] = corner[0];
    length_[first + 2] = length_[second + 2] = cd;
    twin_[first + 2] = second + 2;
    twin_[second + 2] = first + 2;
    return true;
  }

  std::vector<std::uint32_t> from_, twin_;
  std::vector<double> length_;
};

}  // namespace

double area_from_lengths(EdgeLengths l) {
  std::sort(l.begin(), l.end(), std::greater<>());
  const double product =
      (l[0] + (l[1] + l[2])) * (l[2] - (l[0] - l[1])) * (l[2] + (l[0] - l[1])) * (l[0] + (l[1] - l[2]));
  return product > 0 ? 0.25 * std::sqrt(product) : 0;
}

bool has_edge_of_many_faces(std::span<const Face> faces, std::size_t vertex_count) {
  const std::vector<EdgeUse> uses = edge_uses(faces, vertex_count);
  bool any = false;
  for_each_edge(std::span(uses), [&](std::span<const EdgeUse> edge) { any = any || edge.size() > 2; });
  return any;
}

IntrinsicTriangles delaunay_cover(std::span<const Vec3> positions, std::span<const Face> faces,
                                  std::span<const EdgeLengths> lengths) {
  Cover cover(positions, faces, lengths);
  const std::size_t flips = cover.flip_to_delaunay();
  return cover.triangles(flips);
}

}  // namespace eigencast
