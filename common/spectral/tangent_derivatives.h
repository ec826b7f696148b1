// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/surface/surface.h"

namespace eigencast {

/// Derivatives of functions on a surface at each vertex along two tangents, as sums over the vertex and its neighbours.
/// Those of the positions that they were made of are the tangents themselves: two vectors of unit length at right
/// angles, whose cross product looks to the outer side of the faces (of points: to either).
struct TangentDerivatives {
  struct Term {
    std::uint32_t vertex;
    double along_x, along_y;
  };
  std::vector<std::uint32_t> first{0};  ///< Of each vertex' terms; one more at the end.
  std::vector<Term> terms;              ///< None where faces span no plane.

  std::span<const Term> of(std::size_t vertex) const {
    return std::span(terms).subspan(first[vertex], first[vertex + 1] - first[vertex]);
  }
};

/// From the gradients of the faces round a vertex, weighted by their areas, projected on the plane of their normals'
/// sum.
///   faces    empty for points, whose neighbours are triangulated
///   parents  for each vertex one before it that is near, or itself: tangents are turned to lie along those of the
///            parent
/// REQUIRES: sizes agree; at least 4 positions where there are no faces.
TangentDerivatives tangent_derivatives(std::span<const Vec3> positions, std::span<const Face> faces,
                                       std::span<const std::uint32_t> parents);

}  // namespace eigencast
