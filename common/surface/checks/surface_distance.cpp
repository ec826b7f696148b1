// SPDX-License-Identifier: MIT
#include "common/surface/checks/surface_distance.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <numeric>

namespace eigencast {
namespace {

constexpr std::size_t kLeaf = 4;
constexpr std::size_t kDeepest = 64;  // halving 32-bit counts
constexpr double kNever = std::numeric_limits<double>::infinity();

void grow(Box& box, const Vec3& p) {
  const bool empty = box.low[0] > box.high[0];
  for (std::size_t axis = 0; axis < 3; ++axis) {
    box.low[axis] = empty ? p[axis] : std::min(box.low[axis], p[axis]);
    box.high[axis] = empty ? p[axis] : std::max(box.high[axis], p[axis]);
  }
}

double squared_to_box(const Box& box, const Vec3& p) {
  double sum = 0;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const double beyond = std::max({box.low[axis] - p[axis], p[axis] - box.high[axis], 0.0});
    sum += beyond * beyond;
  }
  return sum;
}

double squared_to_segment(const Vec3& p, const Vec3& a, const Vec3& b) {
  const Vec3 along = b - a, from = p - a;
  const double squared_length = dot(along, along);
  const double t = squared_length > 0 ? std::clamp(dot(from, along) / squared_length, 0.0, 1.0) : 0;
  return squared_distance(from, t * along);
}

/// Where a ray enters a box; infinite: nowhere, or after `best`.
double way_to_box(const Vec3& from, const Vec3& along, const Box& box, double best) {
  double enters = 0;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const double a = (box.low[axis] - from[axis]) / along[axis], b = (box.high[axis] - from[axis]) / along[axis];
    if (std::isnan(a) || std::isnan(b)) continue;  // along a side of the box
    enters = std::max(enters, std::min(a, b));
    best = std::min(best, std::max(a, b));
  }
  return enters <= best ? enters : kNever;
}

/// Moeller, Trumbore 1997, "Fast, minimum storage ray-triangle intersection".
double way_to_triangle(const Vec3& from, const Vec3& along, const Vec3& a, const Vec3& b, const Vec3& c) {
  const Vec3 ab = b - a, ac = c - a, p = cross(along, ac), s = from - a, q = cross(s, ab);
  const double determinant = dot(ab, p);
  if (determinant == 0) return kNever;
  const double u = dot(s, p) / determinant, v = dot(along, q) / determinant;
  return u < 0 || v < 0 || u + v > 1 ? kNever : dot(ac, q) / determinant;
}

/// Also takes triangles without area.
double squared_to_triangle(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c) {
  const Vec3 normal = cross(b - a, c - a);
  const double squared_normal = dot(normal, normal);
  const auto inside = [&](const Vec3& from, const Vec3& to) { return dot(cross(to - from, p - from), normal) >= 0; };
  if (squared_normal > 0 && inside(a, b) && inside(b, c) && inside(c, a)) {
    const double height = dot(p - a, normal);
    return height * height / squared_normal;
  }
  return std::min({squared_to_segment(p, a, b), squared_to_segment(p, b, c), squared_to_segment(p, c, a)});
}

}  // namespace

SurfaceDistance::SurfaceDistance(std::span<const Vec3> positions, std::span<const Face> faces)
    : positions_(positions.begin(), positions.end()), faces_(faces.begin(), faces.end()) {
  assert(!positions.empty());
  order_.resize(faces_.empty() ? positions_.size() : faces_.size());
  std::iota(order_.begin(), order_.end(), 0U);
  std::vector<Vec3> centres(order_.size());
  for (std::uint32_t i = 0; i < centres.size(); ++i) {
    const Box box = box_of(i);
    for (std::size_t axis = 0; axis < 3; ++axis) centres[i][axis] = (box.low[axis] + box.high[axis]) / 2;
  }
  nodes_.reserve(order_.size());
  build(order_, centres);
  move_to(positions);
}

/// Halves at the median along the longest side of the centres' box.
std::uint32_t SurfaceDistance::build(std::span<std::uint32_t> entries, std::span<const Vec3> centres) {
  const auto index = static_cast<std::uint32_t>(nodes_.size());
  nodes_.emplace_back();
  if (entries.size() <= kLeaf) {
    nodes_[index].first = static_cast<std::uint32_t>(entries.data() - order_.data());
    nodes_[index].count = static_cast<std::uint32_t>(entries.size());
    return index;
  }
  Box box;
  for (const std::uint32_t entry : entries) grow(box, centres[entry]);
  const Vec3 sides = box.high - box.low;
  const auto axis = static_cast<std::size_t>(std::max_element(sides.begin(), sides.end()) - sides.begin());
  const std::size_t half = entries.size() / 2;
  std::nth_element(entries.begin(), entries.begin() + static_cast<std::ptrdiff_t>(half), entries.end(),
                   [&](std::uint32_t a, std::uint32_t b) { return centres[a][axis] < centres[b][axis]; });
  build(entries.first(half), centres);
  const std::uint32_t right = build(entries.subspan(half), centres);
  nodes_[index].first = right;
  return index;
}

void SurfaceDistance::move_to(std::span<const Vec3> positions) {
  assert(positions.size() == positions_.size());
  std::copy(positions.begin(), positions.end(), positions_.begin());
  for (std::size_t i = nodes_.size(); i-- > 0;) {
    Node& node = nodes_[i];
    node.box = {};
    const auto add = [&node](const Box& part) {
      grow(node.box, part.low);
      grow(node.box, part.high);
    };
    for (std::uint32_t k = 0; k < node.count; ++k) add(box_of(order_[node.first + k]));
    if (node.count == 0) {
      add(nodes_[i + 1].box);
      add(nodes_[node.first].box);
    }
  }
}

Box SurfaceDistance::box_of(std::uint32_t entry) const {
  Box box;
  if (faces_.empty()) {
    grow(box, positions_[entry]);
  } else {
    for (const std::uint32_t corner : faces_[entry]) grow(box, positions_[corner]);
  }
  return box;
}

double SurfaceDistance::squared_to(std::uint32_t entry, const Vec3& p) const {
  if (faces_.empty()) return squared_distance(p, positions_[entry]);
  const Face& face = faces_[entry];
  return squared_to_triangle(p, positions_[face[0]], positions_[face[1]], positions_[face[2]]);
}

double SurfaceDistance::squared(const Vec3& p, double known, double enough) const {
  struct Open {
    std::uint32_t node;
    double squared;  // of p to its box
  };
  std::array<Open, kDeepest> stack;
  std::size_t open = 0;
  stack[open++] = {0, squared_to_box(nodes_[0].box, p)};
  double best = known;
  while (open > 0 && best > enough) {
    const Open next = stack[--open];
    if (next.squared >= best) continue;
    const Node& node = nodes_[next.node];
    for (std::uint32_t k = 0; k < node.count; ++k) best = std::min(best, squared_to(order_[node.first + k], p));
    if (node.count > 0) continue;
    Open left{next.node + 1, squared_to_box(nodes_[next.node + 1].box, p)};
    Open right{node.first, squared_to_box(nodes_[node.first].box, p)};
    if (left.squared < right.squared) std::swap(left, right);
    stack[open++] = left;  // the nearer one on top
    stack[open++] = right;
  }
  return best;
}

double SurfaceDistance::way_to(const Vec3& from, const Vec3& along, double beyond) const {
  assert(!faces_.empty());
  std::array<std::uint32_t, kDeepest> stack;
  std::size_t open = 0;
  stack[open++] = 0;
  double best = kNever;
  while (open > 0) {
    const std::uint32_t index = stack[--open];
    const Node& node = nodes_[index];
    if (way_to_box(from, along, node.box, best) == kNever) continue;
    for (std::uint32_t k = 0; k < node.count; ++k) {
      const Face& face = faces_[order_[node.first + k]];
      const double way = way_to_triangle(from, along, positions_[face[0]], positions_[face[1]], positions_[face[2]]);
      if (way > beyond) best = std::min(best, way);
    }
    if (node.count > 0) continue;
    stack[open++] = node.first;
    stack[open++] = index + 1;
  }
  return best;
}

double farthest_squared(std::span<const Vec3> points, const SurfaceDistance& surface, std::span<const double> bounds,
                        double so_far) {
  assert(bounds.empty() || bounds.size() == points.size());
  double farthest = so_far;
  const auto take = [&](std::size_t i) {
    const double bound = bounds.empty() ? std::numeric_limits<double>::infinity() : bounds[i];
    if (bound > farthest) farthest = std::max(farthest, surface.squared(points[i], bound, farthest));
  };
  // The most promising first: what follows then mostly needs no search.
  if (!bounds.empty()) take(static_cast<std::size_t>(std::max_element(bounds.begin(), bounds.end()) - bounds.begin()));
  for (std::size_t i = 0; i < points.size(); ++i) take(i);
  return farthest;
}

}  // namespace eigencast
