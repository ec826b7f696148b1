// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/Core>
#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <array>
#include <span>
#include <vector>

#include "common/surface/surface.h"

namespace eigencast::bench {

/// A detailed mesh carried by its smooth base at full resolution (Botsch, Sumner, Pauly, Gross 2006, "Deformation
/// Transfer for Detail-Preserving Surface Editing"): each triangle of the base states a deformation gradient, its
/// normal carried along, and the detailed mesh is the one whose gradients come nearest to these, one Poisson problem
/// for each of x, y, z. Not thread-safe.
class DeformationTransfer {
 public:
  /// Factors the system. REQUIRES: faces not empty, both of the same vertices.
  DeformationTransfer(std::span<const Vec3> detailed, std::span<const Vec3> base, std::span<const Face> faces);
  /// The detailed mesh where the base is in `pose`. False where the system could not be factored.
  bool carry(std::span<const Vec3> pose, std::vector<Vec3>& carried) const;

 private:
  Eigen::Matrix3d gradient_of(std::size_t face, std::span<const Vec3> pose) const;

  std::vector<Face> faces_;
  std::vector<Vec3> detailed_;
  std::vector<Eigen::Matrix3d> inverse_frames_;         ///< Belong to the base's triangles at rest; zero: no area.
  std::vector<std::array<double, 3>> half_cotangents_;  ///< Belong to the detailed triangles' corners.
  double attachment_ = 0;
  Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> system_;
};

}  // namespace eigencast::bench
