// SPDX-License-Identifier: MIT
#include "common/spectral/point_operators.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <optional>

#include "common/core/union_find.h"

namespace eigencast {
namespace {

constexpr std::size_t kNeighbours = 30;
constexpr double kCoincident = 1e-9;   // of the box's diagonal
constexpr double kTooNear = 1e-7;      // of the neighbourhood's radius
constexpr double kPushedOutTo = 1e-6;  // of the neighbourhood's radius
constexpr double kCellReach = 0.5;     // of the neighbourhood's radius: points outside cannot cut a cell this small

struct Neighbour {
  std::uint32_t index;
  Eigen::Vector2d inverted;  // in the tangent plane, in units of the radius, x / |x|^2
};

/// Lies in the tangent plane; has no points when all lie on the centre.
struct Neighbourhood {
  std::vector<Neighbour> points;
  double radius = 0;
};

double cross(const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  return a.x() * b.y() - a.y() * b.x();
}

/// Nearest points of each point, itself excluded, by distance; k = min(30, n - 1).
class Neighbourhoods {
 public:
  explicit Neighbourhoods(std::span<const Vec3> positions)
      : points_{positions},
        tree_(3, points_),
        found_(std::min(kNeighbours + 1, positions.size())),
        squared_(found_.size()) {}

  std::span<const std::uint32_t> of(std::uint32_t point) {
    const std::size_t count =
        tree_.knnSearch(points_.positions[point].data(), found_.size(), found_.data(), squared_.data());
    // Among coincident points the query point may be missing, or at any position.
    const auto self = std::find(found_.begin(), found_.begin() + static_cast<std::ptrdiff_t>(count), point);
    if (self == found_.begin() + static_cast<std::ptrdiff_t>(count)) return {found_.data(), count - 1};
    std::rotate(found_.begin(), self, self + 1);
    return {found_.data() + 1, count - 1};
  }

 private:
  PointSet points_;
  KdTree tree_;
  std::vector<std::uint32_t> found_;
  std::vector<double> squared_;
};

/// The star of the origin in the Delaunay triangulation of it and its neighbours. Inversion turns "the circle through
/// the origin and two neighbours is empty" into "the line through their images has the others on the origin's side":
/// the star is the convex hull of the images. An origin on the cloud's rim is a corner of the hull, whose two edges
/// there are not triangles. The circles' centres are the corners of the Voronoi cell. Returns LocalTriangles::cell.
double add_star(std::uint32_t origin, const Neighbourhood& around, std::vector<Face>& faces) {
  std::vector<Neighbour> points = around.points;
  points.push_back({origin, Eigen::Vector2d::Zero()});
  std::sort(points.begin(), points.end(), [](const Neighbour& a, const Neighbour& b) {
    if (a.inverted.x() != b.inverted.x()) return a.inverted.x() < b.inverted.x();
    if (a.inverted.y() != b.inverted.y()) return a.inverted.y() < b.inverted.y();
    return a.index < b.index;
  });
  std::vector<Neighbour> hull(2 * points.size());  // Andrew's monotone chain
  std::size_t size = 0;
  const auto push = [&](const Neighbour& p, std::size_t keep) {
    while (size >= keep + 2 &&
           cross(hull[size - 1].inverted - hull[size - 2].inverted, p.inverted - hull[size - 2].inverted) <= 0) {
      --size;
    }
    hull[size++] = p;
  };
  for (const Neighbour& p : points) push(p, 0);
  const std::size_t lower = size - 1;
  for (std::size_t i = points.size() - 1; i-- > 0;) push(points[i], lower);
  std::vector<Eigen::Vector2d> corners;
  bool closed = true;
  for (std::size_t i = 0; i + 1 < size; ++i) {
    const Neighbour& a = hull[i];
    const Neighbour& b = hull[i + 1];
    const double turn = cross(a.inverted, b.inverted);
    if (a.index == origin || b.index == origin || a.index == b.index || turn <= 0) {
      closed = false;
      continue;
    }
    faces.push_back({origin, a.index, b.index});
    const Eigen::Vector2d edge = b.inverted - a.inverted;
    corners.emplace_back(edge.y() / (2 * turn), -edge.x() / (2 * turn));
    closed = closed && corners.back().norm() <= kCellReach;
  }
  if (!closed || corners.size() < 3) return 0;
  double twice = 0;
  for (std::size_t i = 0; i < corners.size(); ++i) twice += cross(corners[i], corners[(i + 1) % corners.size()]);
  return 0.5 * twice * around.radius * around.radius;
}

Neighbourhood invert(std::span<const Vec3> positions, std::uint32_t centre, std::span<const std::uint32_t> indices) {
  Neighbourhood result;
  const Eigen::Vector3d p = vector_from(positions[centre]);
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  double radius = 0;
  for (const std::uint32_t j : indices) {
    const Eigen::Vector3d d = vector_from(positions[j]) - p;
    covariance += d * d.transpose();
    radius = std::max(radius, d.norm());
  }
  if (!(radius > 0)) return result;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> axes(covariance / (radius * radius));
  const Eigen::Vector3d u = axes.eigenvectors().col(2);
  const Eigen::Vector3d v = axes.eigenvectors().col(1);
  result.radius = radius;
  result.points.reserve(indices.size());
  for (const std::uint32_t j : indices) {
    const Eigen::Vector3d d = (vector_from(positions[j]) - p) / radius;
    Eigen::Vector2d q(d.dot(u), d.dot(v));
    if (q.norm() < kTooNear) q = kPushedOutTo * Eigen::Vector2d(std::cos(double(j)), std::sin(double(j)));
    result.points.push_back({j, q / q.squaredNorm()});
  }
  return result;
}

/// For each point the first one that it coincides with, or itself.
std::vector<std::uint32_t> find_coincident(std::span<const Vec3> positions, Neighbourhoods& neighbourhoods) {
  const double limit = kCoincident * bounding_box(positions).diagonal();
  UnionFind sets(positions.size());
  for (std::uint32_t i = 0; i < positions.size(); ++i) {
    for (const std::uint32_t j : neighbourhoods.of(i)) {
      if ((vector_from(positions[i]) - vector_from(positions[j])).norm() > limit) break;
      sets.join(i, j);
    }
  }
  std::vector<std::uint32_t> leader(positions.size());
  for (std::uint32_t i = 0; i < leader.size(); ++i) leader[i] = sets.root(i);
  return leader;
}

}  // namespace

LocalTriangles local_delaunay(std::span<const Vec3> positions) {
  LocalTriangles result;
  Neighbourhoods all(positions);
  const std::vector<std::uint32_t> leader = find_coincident(positions, all);
  std::vector<std::uint32_t> kept;
  std::vector<Vec3> distinct;
  for (std::uint32_t i = 0; i < positions.size(); ++i) {
    if (leader[i] == i) {
      kept.push_back(i);
      distinct.push_back(positions[i]);
    } else {
      result.coincident.emplace_back(i, leader[i]);
    }
  }
  result.cell.assign(positions.size(), 0);
  if (distinct.size() < 3) return result;
  std::optional<Neighbourhoods> fewer;
  Neighbourhoods& neighbourhoods = result.coincident.empty() ? all : fewer.emplace(distinct);
  result.faces.reserve(6 * distinct.size());
  for (std::uint32_t i = 0; i < distinct.size(); ++i) {
    const Neighbourhood around = invert(distinct, i, neighbourhoods.of(i));
    if (around.points.size() >= 2) result.cell[kept[i]] = add_star(i, around, result.faces);
  }
  for (Face& face : result.faces) {
    for (std::uint32_t& corner : face) corner = kept[corner];
  }
  return result;
}

}  // namespace eigencast
