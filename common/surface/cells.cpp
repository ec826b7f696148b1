// SPDX-License-Identifier: MIT
#include "common/surface/cells.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <string>
#include <tuple>
#include <unordered_map>

#include "common/surface/edge_uses.h"
#include "common/surface/vector.h"

namespace eigencast {
namespace {

constexpr std::uint32_t kNoCorner = ~std::uint32_t{0};
using Side = std::array<std::uint8_t, 4>;  ///< Corners of a cell; the last one of a triangle is repeated.

std::span<const Side> sides_of(CellKind kind) {
  static constexpr Side kTetrahedron[] = {{0, 1, 3, 3}, {1, 2, 3, 3}, {2, 0, 3, 3}, {0, 2, 1, 1}};
  static constexpr Side kHexahedron[] = {{0, 4, 7, 3}, {1, 2, 6, 5}, {0, 1, 5, 4},
                                         {3, 7, 6, 2}, {0, 3, 2, 1}, {4, 5, 6, 7}};
  static constexpr Side kWedge[] = {{0, 1, 2, 2}, {3, 5, 4, 4}, {0, 3, 4, 1}, {1, 4, 5, 2}, {2, 5, 3, 0}};
  static constexpr Side kPyramid[] = {{0, 3, 2, 1}, {0, 1, 4, 4}, {1, 2, 4, 4}, {2, 3, 4, 4}, {3, 0, 4, 4}};
  switch (kind) {
    case CellKind::kTetrahedron:
      return kTetrahedron;
    case CellKind::kHexahedron:
      return kHexahedron;
    case CellKind::kWedge:
      return kWedge;
    case CellKind::kPyramid:
      break;
  }
  return kPyramid;
}

struct CellSide {
  std::array<std::uint32_t, 4> key;      ///< Its points, sorted; kNoCorner after those of a triangle.
  std::array<std::uint32_t, 4> corners;  ///< In order round the side.
  std::size_t cell;
};

CellSide side_of(std::span<const std::uint32_t> cell, const Side& side, std::size_t number) {
  CellSide made{{}, {}, number};
  for (std::size_t k = 0; k < 4; ++k) made.corners[k] = cell[side[k]];
  made.key = made.corners;
  if (side[2] == side[3]) made.key[3] = made.corners[3] = kNoCorner;
  std::sort(made.key.begin(), made.key.end());
  return made;
}

Vec3 middle_of(std::span<const Vec3> points, std::span<const std::uint32_t> of) {
  Vec3 sum{0, 0, 0};
  for (const std::uint32_t i : of) sum = sum + points[i];
  return (1.0 / static_cast<double>(of.size())) * sum;
}

void add_outward(std::span<const Vec3> points, std::span<const std::uint32_t> cell, const CellSide& side,
                 std::vector<Face>& faces) {
  const std::size_t count = side.corners[3] == kNoCorner ? 3 : 4;
  std::array<std::uint32_t, 4> c = side.corners;
  const Vec3 &a = points[c[0]], &b = points[c[1]], &d = points[c[count - 1]];
  const Vec3 normal = count == 4 ? cross(points[c[2]] - a, d - b) : cross(b - a, d - a);
  const Vec3 outward = middle_of(points, std::span(c).first(count)) - middle_of(points, cell);
  if (dot(normal, outward) < 0) std::reverse(c.begin(), c.begin() + static_cast<std::ptrdiff_t>(count));
  for (std::size_t k = 2; k < count; ++k) faces.push_back({c[0], c[k - 1], c[k]});
}

/// Numbers only the points that `faces` have.
PickedSurface picked(std::vector<Face> faces, std::size_t point_count) {
  PickedSurface result;
  std::vector<std::uint32_t> number(point_count, 0);
  for (const Face& f : faces)
    for (const std::uint32_t v : f) number[v] = 1;
  for (std::uint32_t v = 0; v < point_count; ++v) {
    if (number[v] == 0) continue;
    number[v] = static_cast<std::uint32_t>(result.vertices.size());
    result.vertices.push_back(v);
  }
  for (Face& f : faces)
    for (std::uint32_t& v : f) v = number[v];
  result.faces = std::move(faces);
  return result;
}

using Place = std::array<std::int64_t, 3>;
struct PlaceHash {
  std::size_t operator()(const Place& p) const {
    std::uint64_t hash = 0;
    for (const std::int64_t x : p) {
      hash = (hash ^ static_cast<std::uint64_t>(x)) * 0x9E3779B97F4A7C15U;
      hash ^= hash >> 32;
    }
    return static_cast<std::size_t>(hash);
  }
};

/// First points of their place, found again by boxes as wide as the tolerance.
class FirstPoints {
 public:
  FirstPoints(std::span<const Vec3> points, double tolerance) : points_(points), tolerance_(tolerance) {}

  /// The lowest one within the tolerance of point i, which becomes one itself where there is none.
  std::uint32_t first_near(std::uint32_t i) {
    const Place place = place_of(points_[i]);
    std::uint32_t first = i;
    const std::int64_t reach = tolerance_ > 0 ? 1 : 0;
    for (std::int64_t x = -reach; x <= reach; ++x)
      for (std::int64_t y = -reach; y <= reach; ++y)
        for (std::int64_t z = -reach; z <= reach; ++z)
          first = std::min(first, nearest_in({place[0] + x, place[1] + y, place[2] + z}, i));
    if (first == i) boxes_[place].push_back(i);
    return first;
  }

 private:
  Place place_of(const Vec3& p) const {
    Place place;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      // Adding 0 makes -0 and 0 one.
      place[axis] = tolerance_ > 0 ? static_cast<std::int64_t>(std::floor(p[axis] / tolerance_))
                                   : std::bit_cast<std::int64_t>(p[axis] + 0.0);
    }
    return place;
  }
  std::uint32_t nearest_in(const Place& place, std::uint32_t i) const {
    const auto box = boxes_.find(place);
    if (box == boxes_.end()) return i;
    for (const std::uint32_t other : box->second) {
      if (length(points_[other] - points_[i]) <= tolerance_) return other;
    }
    return i;
  }

  std::span<const Vec3> points_;
  double tolerance_;
  std::unordered_map<Place, std::vector<std::uint32_t>, PlaceHash> boxes_;  ///< Growing; a few each.
};

constexpr double kMostBoxes = 1e15;  // along an axis

}  // namespace

std::size_t corners_of(CellKind kind) {
  constexpr std::array<std::size_t, 4> kCorners{4, 8, 6, 5};
  return kCorners[static_cast<std::size_t>(kind)];
}

Result<std::vector<Face>> fanned(std::span<const std::uint32_t> connectivity, std::span<const std::uint64_t> offsets) {
  if (offsets.empty() || offsets.front() != 0 || offsets.back() != connectivity.size() ||
      !std::is_sorted(offsets.begin(), offsets.end())) {
    return fail(ErrorCode::kInvalidArgument,
                "the offsets of polygons must begin at 0, never fall, and end at the number of corners, " +
                    std::to_string(connectivity.size()) + ": one more than there are polygons");
  }
  if (connectivity.size() > 3 * kMaxSurfaceFaces)
    return fail(ErrorCode::kTooLarge, "polygons of " + std::to_string(connectivity.size()) + " corners in all");
  std::vector<Face> faces;
  faces.reserve(connectivity.size() / 2);
  for (std::size_t i = 0; i + 1 < offsets.size(); ++i) {
    const auto polygon = connectivity.subspan(offsets[i], offsets[i + 1] - offsets[i]);
    for (std::size_t k = 2; k < polygon.size(); ++k) faces.push_back({polygon[0], polygon[k - 1], polygon[k]});
  }
  return faces;
}

Result<PickedSurface> boundary_of(std::span<const Vec3> points, std::span<const std::uint32_t> cells, CellKind kind) {
  const std::size_t width = corners_of(kind), count = cells.size() / width;
  if (cells.size() != count * width)
    return fail(ErrorCode::kInvalidArgument, "cells must have " + std::to_string(width) + " corners each");
  if (const auto high = std::max_element(cells.begin(), cells.end()); high != cells.end() && *high >= points.size())
    return fail(ErrorCode::kInvalidArgument, "a cell names point " + std::to_string(*high) + " of " +
                                                 std::to_string(points.size()) + "; the first one is 0");
  std::vector<CellSide> sides;
  sides.reserve(count * sides_of(kind).size());
  for (std::size_t c = 0; c < count; ++c)
    for (const Side& side : sides_of(kind)) sides.push_back(side_of(cells.subspan(c * width, width), side, c));
  std::sort(sides.begin(), sides.end(),
            [](const CellSide& a, const CellSide& b) { return std::tie(a.key, a.cell) < std::tie(b.key, b.cell); });
  std::vector<Face> faces;
  for (std::size_t first = 0, last = 0; first < sides.size(); first = last) {
    while (last < sides.size() && sides[last].key == sides[first].key) ++last;
    if (last - first == 1) add_outward(points, cells.subspan(sides[first].cell * width, width), sides[first], faces);
  }
  return picked(std::move(faces), points.size());
}

Result<PickedSurface> welded(const Surface& surface, double tolerance) {
  if (const auto good = check_values(surface); !good) return good.error();
  if (!(tolerance >= 0) || !std::isfinite(tolerance))
    return fail(ErrorCode::kInvalidArgument, "the tolerance must be a length, 0 for points at the same place");
  const Box box = bounding_box(surface.positions);
  for (std::size_t axis = 0; tolerance > 0 && axis < 3; ++axis) {
    if (std::max(std::abs(box.low[axis]), std::abs(box.high[axis])) / tolerance > kMostBoxes)
      return fail(ErrorCode::kInvalidArgument, "the tolerance is below what the points' coordinates can tell; give 0");
  }
  PickedSurface result;
  FirstPoints firsts(surface.positions, tolerance);
  std::vector<std::uint32_t> number(surface.vertex_count());
  for (std::uint32_t i = 0; i < number.size(); ++i) {
    const std::uint32_t first = firsts.first_near(i);
    number[i] = first == i ? static_cast<std::uint32_t>(result.vertices.size()) : number[first];
    if (first == i) result.vertices.push_back(i);
  }
  for (const Face& f : surface.faces) {
    const Face joined{number[f[0]], number[f[1]], number[f[2]]};
    if (has_three_corners(joined, result.vertices.size())) result.faces.push_back(joined);
  }
  return result;
}

bool is_triangle_soup(const Surface& surface) {
  if (surface.faces.size() < 2) return false;
  std::vector<bool> used(surface.vertex_count());
  std::size_t corners = 0;
  for (const Face& f : surface.faces) {
    for (const std::uint32_t v : f) {
      if (v >= used.size() || used[v]) continue;
      used[v] = true;
      ++corners;
    }
  }
  if (10 * corners < 27 * surface.faces.size()) return false;
  const auto joined = welded(surface, 0);
  return joined && 4 * joined->vertices.size() < 3 * surface.vertex_count();
}

}  // namespace eigencast
