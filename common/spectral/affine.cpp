// SPDX-License-Identifier: MIT
#include "common/spectral/affine.h"

#include <cmath>

namespace eigencast {
namespace {

constexpr double kFlat = 1e-13;  // relative residual below which a coordinate is dependent

}  // namespace

PositionMap matrix_from_positions(std::span<const Vec3> positions) {
  static_assert(sizeof(Vec3) == 3 * sizeof(double));
  return {positions.empty() ? nullptr : positions.front().data(), static_cast<Eigen::Index>(positions.size()), 3};
}

Eigen::MatrixXd centred_rest(std::span<const Vec3> positions, const Eigen::VectorXd& mass) {
  Eigen::MatrixXd rest = matrix_from_positions(positions);
  const Eigen::RowVector3d centroid = mass.transpose() * rest / mass.sum();
  rest.rowwise() -= centroid;
  const double size = std::sqrt((mass.asDiagonal() * rest.cwiseAbs2()).sum() / mass.sum());
  return size > 0 ? Eigen::MatrixXd(rest / size) : rest;
}

Eigen::MatrixXd orthonormal_affine(const Eigen::VectorXd& root_mass, const Eigen::MatrixXd& rest) {
  Eigen::MatrixXd columns(root_mass.size(), 4);
  columns.col(0) = root_mass.normalized();
  Eigen::Index count = 1;
  for (Eigen::Index axis = 0; axis < 3; ++axis) {
    Eigen::VectorXd column = root_mass.cwiseProduct(rest.col(axis));
    for (int pass = 0; pass < 3; ++pass) {
      const auto before = columns.leftCols(count);
      column -= before * (before.transpose() * column);
      if (pass == 0 && column.norm() < kFlat * root_mass.norm()) column.setZero();
      column.normalize();  // leaves zero as it is
    }
    if (column.norm() < 0.5) continue;
    columns.col(count++) = column;
  }
  return columns.leftCols(count);
}

}  // namespace eigencast
