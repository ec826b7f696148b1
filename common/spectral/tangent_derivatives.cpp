// SPDX-License-Identifier: MIT
#include "common/spectral/tangent_derivatives.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <array>
#include <cassert>
#include <map>

#include "common/spectral/point_operators.h"

namespace eigencast {
namespace {

using Vector = Eigen::Vector3d;

constexpr double kMinArea = 1e-3;   // that two unit tangents span, or the faces' gradients are meaningless
constexpr double kMinLength = 0.1;  // of a parent's tangent in the vertex's plane, or another direction is used

/// Sums over the faces of each vertex.
struct FaceSums {
  std::vector<Vector> normals;                             ///< Twice the area long.
  std::vector<double> areas;                               ///< Twice.
  std::vector<std::map<std::uint32_t, Vector>> gradients;  ///< Likewise, by the vertex whose value they multiply.
};

FaceSums sums_over_faces(std::span<const Vec3> positions, std::span<const Face> faces) {
  FaceSums sums{std::vector<Vector>(positions.size(), Vector::Zero()), std::vector<double>(positions.size(), 0),
                std::vector<std::map<std::uint32_t, Vector>>(positions.size())};
  for (const Face& face : faces) {
    const Vector a = vector_from(positions[face[0]]), b = vector_from(positions[face[1]]),
                 c = vector_from(positions[face[2]]);
    const Vector normal = (b - a).cross(c - a);
    const double twice_area = normal.norm();
    if (!(twice_area > 0)) continue;
    const Vector n = normal / twice_area;
    const std::array<Vector, 3> gradients = {n.cross(c - b), n.cross(a - c), n.cross(b - a)};
    for (const std::uint32_t i : face) {
      // Triangles of points are not oriented: each is turned to the side of the first.
      sums.normals[i] += sums.normals[i].dot(normal) < 0 ? Vector(-normal) : normal;
      sums.areas[i] += twice_area;
      for (std::size_t k = 0; k < 3; ++k)
        sums.gradients[i].try_emplace(face[k], Vector::Zero()).first->second += gradients[k];
    }
  }
  return sums;
}

struct Tangents {
  Vector x = Vector::Zero(), y = Vector::Zero();
  bool any() const { return !x.isZero(0); }
};

/// Two tangents across `normal`, the first along the parent's where it has one.
Tangents tangents_across(const Vector& normal, const Tangents& parent) {
  const Vector n = normal.normalized();
  Vector x = parent.x - n.dot(parent.x) * n;
  if (x.norm() < kMinLength) x = n.unitOrthogonal();
  x.normalize();
  return {x, n.cross(x)};
}

}  // namespace

TangentDerivatives tangent_derivatives(std::span<const Vec3> positions, std::span<const Face> faces,
                                       std::span<const std::uint32_t> parents) {
  assert(parents.size() == positions.size());
  const bool points = faces.empty();
  const FaceSums sums = sums_over_faces(
      positions, points ? local_delaunay(positions).faces : std::vector<Face>(faces.begin(), faces.end()));
  TangentDerivatives derivatives;
  std::vector<Tangents> tangents(positions.size());
  const auto end_vertex = [&] { derivatives.first.push_back(static_cast<std::uint32_t>(derivatives.terms.size())); };
  for (std::size_t i = 0; i < positions.size(); ++i, end_vertex()) {
    const Tangents parent = parents[i] < i ? tangents[parents[i]] : Tangents();
    const bool turn = points && parent.any() && sums.normals[i].dot(parent.x.cross(parent.y)) < 0;
    const Vector normal = turn ? Vector(-sums.normals[i]) : sums.normals[i];
    if (!(normal.norm() > 0)) continue;
    // Derivatives of the positions themselves: not exactly the tangents where faces meet at an angle.
    const Tangents along = tangents_across(normal, parent);
    Vector dx = Vector::Zero(), dy = Vector::Zero();
    for (const auto& [j, gradient] : sums.gradients[i]) {
      dx += along.x.dot(gradient) / sums.areas[i] * vector_from(positions[j]);
      dy += along.y.dot(gradient) / sums.areas[i] * vector_from(positions[j]);
    }
    const Vector across = dx.cross(dy);
    if (across.norm() < kMinArea) continue;
    tangents[i] = tangents_across(across, along);
    const auto& [x, y] = tangents[i];
    Eigen::Matrix2d made;
    made << x.dot(dx), x.dot(dy), y.dot(dx), y.dot(dy);
    const Eigen::Matrix2d mend = made.inverse();
    for (const auto& [j, gradient] : sums.gradients[i]) {
      const Eigen::RowVector2d row(along.x.dot(gradient) / sums.areas[i], along.y.dot(gradient) / sums.areas[i]);
      const Eigen::RowVector2d mended = row * mend;
      derivatives.terms.push_back({j, mended[0], mended[1]});
    }
  }
  return derivatives;
}

}  // namespace eigencast
