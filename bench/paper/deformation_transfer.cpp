// SPDX-License-Identifier: MIT
#include "bench/paper/deformation_transfer.h"

#include <Eigen/Geometry>
#include <Eigen/LU>

namespace eigencast::bench {
namespace {

using Vector = Eigen::Vector3d;

// Scales the mean diagonal: vertices hang on the base by so little that it only fixes the whole's position.
constexpr double kAttachment = 1e-6;

Vector vector_of(const Vec3& v) {
  return {v[0], v[1], v[2]};
}

/// Two edges and the unit normal of a triangle.
Eigen::Matrix3d frame_of(std::span<const Vec3> positions, const Face& face) {
  const Vector a = vector_of(positions[face[0]]);
  Eigen::Matrix3d frame;
  frame.col(0) = vector_of(positions[face[1]]) - a;
  frame.col(1) = vector_of(positions[face[2]]) - a;
  frame.col(2) = frame.col(0).cross(frame.col(1)).normalized();
  return frame;
}

}  // namespace

DeformationTransfer::DeformationTransfer(std::span<const Vec3> detailed, std::span<const Vec3> base,
                                         std::span<const Face> faces)
    : faces_(faces.begin(), faces.end()), detailed_(detailed.begin(), detailed.end()) {
  const auto n = static_cast<Eigen::Index>(detailed.size());
  std::vector<Eigen::Triplet<double>> entries;
  double diagonal = 0;
  for (const Face& face : faces_) {
    const Eigen::Matrix3d frame = frame_of(base, face);
    const bool has_area = std::abs(frame.determinant()) > 0;
    inverse_frames_.push_back(has_area ? Eigen::Matrix3d(frame.inverse()) : Eigen::Matrix3d(Eigen::Matrix3d::Zero()));
    std::array<double, 3>& half = half_cotangents_.emplace_back();
    for (std::size_t k = 0; has_area && k < 3; ++k) {
      const std::uint32_t i = face[(k + 1) % 3], j = face[(k + 2) % 3];
      const Vector u = vector_of(detailed[i]) - vector_of(detailed[face[k]]);
      const Vector v = vector_of(detailed[j]) - vector_of(detailed[face[k]]);
      const double sine = u.cross(v).norm();
      half[k] = sine > 0 ? u.dot(v) / sine / 2 : 0;
      for (const auto& [row, column, sign] : {std::tuple(i, i, 1.0), {j, j, 1.0}, {i, j, -1.0}, {j, i, -1.0}})
        entries.emplace_back(row, column, sign * half[k]);
      diagonal += 2 * half[k];
    }
  }
  attachment_ = kAttachment * diagonal / static_cast<double>(n);
  for (int i = 0; i < n; ++i) entries.emplace_back(i, i, attachment_);
  Eigen::SparseMatrix<double> A(n, n);
  A.setFromTriplets(entries.begin(), entries.end());
  system_.compute(A);
}

Eigen::Matrix3d DeformationTransfer::gradient_of(std::size_t face, std::span<const Vec3> pose) const {
  return frame_of(pose, faces_[face]) * inverse_frames_[face];
}

bool DeformationTransfer::carry(std::span<const Vec3> pose, std::vector<Vec3>& carried) const {
  if (system_.info() != Eigen::Success) return false;
  const auto n = static_cast<Eigen::Index>(detailed_.size());
  Eigen::MatrixX3d right(n, 3);
  for (Eigen::Index i = 0; i < n; ++i) right.row(i) = attachment_ * vector_of(pose[static_cast<std::size_t>(i)]);
  for (std::size_t f = 0; f < faces_.size(); ++f) {
    const Eigen::Matrix3d gradient = gradient_of(f, pose);
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t i = faces_[f][(k + 1) % 3], j = faces_[f][(k + 2) % 3];
      const Vector edge = gradient * (vector_of(detailed_[i]) - vector_of(detailed_[j]));
      right.row(i) += half_cotangents_[f][k] * edge.transpose();
      right.row(j) -= half_cotangents_[f][k] * edge.transpose();
    }
  }
  const Eigen::MatrixX3d solved = system_.solve(right);
  carried.resize(detailed_.size());
  for (Eigen::Index i = 0; i < n; ++i)
    carried[static_cast<std::size_t>(i)] = {solved(i, 0), solved(i, 1), solved(i, 2)};
  return true;
}

}  // namespace eigencast::bench
