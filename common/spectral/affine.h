// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/Core>
#include <span>

#include "common/surface/surface.h"

/// The affine images of the rest pose, which bases hold exactly. Private to common/spectral.
namespace eigencast {

using PositionMap = Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>>;

/// n x 3, without a copy.
PositionMap matrix_from_positions(std::span<const Vec3> positions);

/// x0, y0, z0 (n x 3) about the M-centroid, in units of their root mean square.
Eigen::MatrixXd centred_rest(std::span<const Vec3> positions, const Eigen::VectorXd& mass);

/// M^{1/2} times 1, x0, y0, z0, orthonormalised in this order: n x (1..4), without dependent coordinates.
///   rest  from centred_rest
Eigen::MatrixXd orthonormal_affine(const Eigen::VectorXd& root_mass, const Eigen::MatrixXd& rest);

}  // namespace eigencast
