// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "common/core/result.h"
#include "common/surface/surface.h"

namespace eigencast {

/// How what a basis leaves out of the rest pose comes back in other poses.
enum class DetailKind {
  kNone,
  kNormal,  ///< As heights along the normals of what the basis holds: the paper's.
  kFrames,  ///< As displacements that turn with it.
};
/// "none", "normal", "frames". Errors: kInvalidArgument.
Result<DetailKind> detail_from_name(std::string_view name);

/// Detail d_i = x0_i - b_i of the rest pose over its base B, the rest pose as the basis holds it; in a pose with base B(t)
///   kNormal  x_i = b_i(t) + (d_i . n_i(B)) n_i(B(t))
///   kFrames  x_i = b_i(t) + R_i(t) d_i, R_i the rotation nearest to the gradient of B -> B(t) at i, which carries n_i(B) to n_i(B(t))
/// Normals are cross products of two derivatives along fixed tangents of B, which are linear in B(t) and therefore in the
/// coefficients: the same at every level of detail, for points as well as for meshes. Thread-safe.
class Detail {
 public:
  /// faces: of the surface; empty for points, whose neighbours are triangulated. REQUIRES: sizes agree; at least 4 positions.
  Detail(DetailKind kind, std::span<const Vec3> rest, std::span<const Vec3> base, std::span<const Face> faces);

  /// Adds the detail to a pose of the base, n positions.
  void add_to(std::span<Vec3> pose) const;
  /// d_i . n_i(B), n of them.
  std::vector<double> heights() const;

 private:
  struct Term {
    std::uint32_t vertex;
    double along_u, along_v;
  };
  /// The derivatives of a pose along two fixed tangents and their unit normal, as columns; zero where they span no plane.
  Eigen::Matrix3d frame_of(std::size_t i, std::span<const Vec3> pose) const;
  Eigen::Vector3d displacement(std::size_t i, const Eigen::Matrix3d& now) const;

  DetailKind kind_;
  std::vector<std::uint32_t> first_;   ///< Of each vertex' terms; one more at the end.
  std::vector<Term> terms_;            ///< Derivatives as sums over neighbours: rows of the gradient.
  std::vector<Eigen::Matrix3d> base_;  ///< Frames of the base; zero where there is none.
  std::vector<Eigen::Vector3d> detail_;
};

}  // namespace eigencast
