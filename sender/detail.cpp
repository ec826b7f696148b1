// SPDX-License-Identifier: MIT
#include "sender/detail.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <array>
#include <cassert>
#include <map>
#include <string>

#include "common/spectral/local_delaunay.h"
#include "sender/deform/rigidity.h"

namespace eigencast {
namespace {

using Vector = Eigen::Vector3d;

Vector vector_of(const Vec3& v) {
  return {v[0], v[1], v[2]};
}
/// A triangle with area, and the vectors by which its corners' values count in twice the area times the gradient.
struct Triangle {
  std::uint32_t face;
  std::array<Vector, 3> gradients;  ///< n x e_k, e_k the edge opposite to corner k
  double twice_area;
};

std::vector<Triangle> triangles_with_area(std::span<const Vec3> base, std::span<const Face> faces) {
  std::vector<Triangle> triangles;
  for (std::uint32_t f = 0; f < faces.size(); ++f) {
    const Vector a = vector_of(base[faces[f][0]]), b = vector_of(base[faces[f][1]]), c = vector_of(base[faces[f][2]]);
    const Vector normal = (b - a).cross(c - a);
    const double twice_area = normal.norm();
    if (!(twice_area > 0)) continue;
    const Vector n = normal / twice_area;
    triangles.push_back({f, {n.cross(c - b), n.cross(a - c), n.cross(b - a)}, twice_area});
  }
  return triangles;
}

/// Sums of face normals, each turned to the side of the first: triangles of points have no common side.
std::vector<Vector> normals_of(std::span<const Vec3> base, std::span<const Face> faces) {
  std::vector<Vector> sums(base.size(), Vector::Zero());
  for (const Face& face : faces) {
    const Vector a = vector_of(base[face[0]]);
    const Vector normal = (vector_of(base[face[1]]) - a).cross(vector_of(base[face[2]]) - a);
    for (const std::uint32_t v : face) sums[v] += sums[v].dot(normal) < 0 ? Vector(-normal) : normal;
  }
  return sums;
}

}  // namespace

Result<DetailKind> detail_from_name(std::string_view name) {
  if (name == "none") return DetailKind::kNone;
  if (name == "normal") return DetailKind::kNormal;
  if (name == "frames") return DetailKind::kFrames;
  return fail(ErrorCode::kInvalidArgument,
              "there is no detail '" + std::string(name) + "': use none, normal or frames");
}

Detail::Detail(DetailKind kind, std::span<const Vec3> rest, std::span<const Vec3> base, std::span<const Face> faces)
    : kind_(kind), detail_(base.size()) {
  assert(rest.size() == base.size());
  const std::vector<Face> near = faces.empty() ? local_delaunay(base).faces : std::vector<Face>();
  const std::span<const Face> triangles = faces.empty() ? std::span<const Face>(near) : faces;
  const std::vector<Vector> normals = normals_of(base, triangles);
  std::vector<std::map<std::uint32_t, Vector>> gradients(base.size());  // summed over triangles, times twice their area
  std::vector<double> areas(base.size(), 0);
  for (const Triangle& triangle : triangles_with_area(base, triangles)) {
    for (const std::uint32_t i : triangles[triangle.face]) {
      areas[i] += triangle.twice_area;
      for (std::size_t k = 0; k < 3; ++k)
        gradients[i].try_emplace(triangles[triangle.face][k], Vector::Zero()).first->second += triangle.gradients[k];
    }
  }
  for (std::size_t i = 0; i < base.size(); ++i) {
    detail_[i] = vector_of(rest[i]) - vector_of(base[i]);
    first_.push_back(static_cast<std::uint32_t>(terms_.size()));
    if (!(normals[i].norm() > 0)) continue;
    const Vector u = normals[i].unitOrthogonal(), v = normals[i].normalized().cross(u);
    for (const auto& [j, gradient] : gradients[i])
      terms_.push_back({j, u.dot(gradient) / areas[i], v.dot(gradient) / areas[i]});
  }
  first_.push_back(static_cast<std::uint32_t>(terms_.size()));
  for (std::size_t i = 0; i < base.size(); ++i) base_.push_back(frame_of(i, base));
}

Eigen::Matrix3d Detail::frame_of(std::size_t i, std::span<const Vec3> pose) const {
  Vector u = Vector::Zero(), v = Vector::Zero();
  for (std::uint32_t t = first_[i]; t < first_[i + 1]; ++t) {
    u += terms_[t].along_u * vector_of(pose[terms_[t].vertex]);
    v += terms_[t].along_v * vector_of(pose[terms_[t].vertex]);
  }
  const Vector normal = u.cross(v);
  const double length = normal.norm();
  Eigen::Matrix3d frame = Eigen::Matrix3d::Zero();
  if (length > 0) frame << u, v, normal / length;
  return frame;
}

Vector Detail::displacement(std::size_t i, const Eigen::Matrix3d& now) const {
  if (now.isZero(0) || base_[i].isZero(0)) return detail_[i];
  if (kind_ == DetailKind::kNormal) return detail_[i].dot(base_[i].col(2)) * now.col(2);
  const Eigen::Matrix3d gradient = now * base_[i].inverse();
  return deform::best_rotation(gradient.transpose()) * detail_[i];
}

void Detail::add_to(std::span<Vec3> pose) const {
  assert(pose.size() == detail_.size());
  if (kind_ == DetailKind::kNone) return;
  std::vector<Vector> added(pose.size());
  for (std::size_t i = 0; i < pose.size(); ++i) added[i] = displacement(i, frame_of(i, pose));
  for (std::size_t i = 0; i < pose.size(); ++i) {
    for (std::size_t axis = 0; axis < 3; ++axis) pose[i][axis] += added[i][static_cast<Eigen::Index>(axis)];
  }
}

std::vector<double> Detail::heights() const {
  std::vector<double> heights(detail_.size());
  for (std::size_t i = 0; i < heights.size(); ++i) heights[i] = detail_[i].dot(base_[i].col(2));
  return heights;
}

}  // namespace eigencast
