// SPDX-License-Identifier: MIT
#pragma once

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <random>
#include <vector>

#include "common/spectral/basis.h"
#include "common/surface/shapes/shapes.h"

namespace eigencast::testing {

inline Eigen::MatrixXd matrix_from(std::span<const Vec3> positions) {
  Eigen::MatrixXd X(static_cast<Eigen::Index>(positions.size()), 3);
  for (Eigen::Index i = 0; i < X.rows(); ++i) {
    for (Eigen::Index axis = 0; axis < 3; ++axis) {
      X(i, axis) = positions[static_cast<std::size_t>(i)][static_cast<std::size_t>(axis)];
    }
  }
  return X;
}

/// Largest distance between corresponding vertices over the diagonal of `truth`.
inline double worst_error(std::span<const Vec3> truth, std::span<const Vec3> rebuilt) {
  const Eigen::MatrixXd difference = matrix_from(truth) - matrix_from(rebuilt);
  return difference.rowwise().norm().maxCoeff() / bounding_box(truth).diagonal();
}

inline std::vector<Vec3> round_trip(const Basis& basis, std::span<const Vec3> positions) {
  return positions_from_coefficients(basis, coefficients_from_positions(basis, positions));
}

inline double orthonormality_defect(const Eigen::MatrixXd& Psi, const Eigen::VectorXd& mass) {
  const Eigen::MatrixXd gram = Psi.transpose() * mass.asDiagonal() * Psi;
  return (gram - Eigen::MatrixXd::Identity(gram.rows(), gram.cols())).cwiseAbs().maxCoeff();
}

/// p -> A p + t with fixed A, t that shear, stretch and turn.
inline std::vector<Vec3> affine_image(std::span<const Vec3> positions) {
  std::vector<Vec3> result;
  for (const Vec3& p : positions) {
    result.push_back(
        {1.3 * p[0] - 0.4 * p[1] + 0.2 * p[2] + 5, 0.7 * p[0] + 0.6 * p[1] - 3, -0.9 * p[1] + 2.1 * p[2] + 0.5});
  }
  return result;
}

inline std::vector<Vec3> scaled(std::span<const Vec3> positions, double s) {
  std::vector<Vec3> result(positions.begin(), positions.end());
  for (Vec3& p : result) {
    for (double& x : p) x *= s;
  }
  return result;
}

/// Several surfaces as one, side by side along x.
inline Surface side_by_side(const std::vector<Surface>& parts, double step) {
  Surface result;
  double offset = 0;
  for (const Surface& part : parts) {
    const auto first = static_cast<std::uint32_t>(result.positions.size());
    for (const Vec3& p : part.positions) result.positions.push_back({p[0] + offset, p[1], p[2]});
    for (const Face& f : part.faces) result.faces.push_back({f[0] + first, f[1] + first, f[2] + first});
    offset += step;
  }
  return result;
}

inline Surface square_grid(std::uint32_t side) {
  Surface grid;
  for (std::uint32_t i = 0; i < side * side; ++i)
    grid.positions.push_back(
        {static_cast<double>(i / side) / (side - 1), static_cast<double>(i % side) / (side - 1), 0});
  for (std::uint32_t i = 0; i + side < side * side; ++i) {
    if (i % side + 1 == side) continue;
    grid.faces.push_back({i, i + side, i + 1});
    grid.faces.push_back({i + 1, i + side, i + side + 1});
  }
  return grid;
}

inline double uniform(std::mt19937& generator) {
  return static_cast<double>(generator()) / 4294967296.0;
}

/// A smooth deformation that no affine map makes.
inline std::vector<Vec3> bent(std::span<const Vec3> positions) {
  std::vector<Vec3> result;
  for (const Vec3& p : positions) {
    const double angle = 0.8 * p[0];
    result.push_back(
        {p[0], std::cos(angle) * p[1] - std::sin(angle) * p[2], std::sin(angle) * p[1] + std::cos(angle) * p[2]});
  }
  return result;
}

}  // namespace eigencast::testing
