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

/// Each vertex's neighbours with half the sum of the cotangents across the edge, held between bounds.
std::vector<std::vector<Neighbour>> cotangent_neighbours(std::span<const Vec3> positions, std::span<const Face> faces);

/// The rotation R that brings edges p_k nearest to x_k, where S = sum of w_k p_k x_k^T: the greatest trace of R S.
Eigen::Matrix3d best_rotation(const Eigen::Matrix3d& S);

}  // namespace eigencast::deform
