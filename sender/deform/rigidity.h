// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "common/surface/surface.h"

/// What as-rigid-as-possible deformers share. Private to sender/deform.
namespace eigencast::deform {

struct Neighbour {
  std::uint32_t vertex;
  double weight;
};

/// Half the sum of the cotangents across the edge, held between bounds.
std::vector<std::vector<Neighbour>> cotangent_neighbours(std::span<const Vec3> positions, std::span<const Face> faces);

/// The R of the greatest trace of R S, where S = sum of w_k p_k x_k^T: brings edges p_k nearest to x_k.
Eigen::Matrix3d best_rotation(const Eigen::Matrix3d& S);

}  // namespace eigencast::deform
