// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/surface/surface.h"

namespace eigencast {

/// Derivatives of functions on a surface at each vertex along two tangents, as sums over the vertex and its neighbours.
/// The derivatives of the positions are the tangents: orthonormal, their cross product on the faces' outer side
/// (points: on either side).
struct TangentDerivatives {
  struct Term {
    std::uint32_t vertex;
    double along_x, along_y;
  };
  std::vector<std::uint32_t> first{0};  ///< The first term of each vertex; one more at the end.
  std::vector<Term> terms;              ///< None for vertices whose faces span no plane.

  std::span<const Term> of(std::size_t vertex) const {
    return std::span(terms).subspan(first[vertex], first[vertex + 1] - first[vertex]);
  }
};

/// Area-weighted gradients of the faces around a vertex, projected on the plane of their mean normal.
///   faces    empty for points, whose neighbours are triangulated
///   parents  a near vertex before each vertex, or itself; tangents are aligned with the parent's
/// REQUIRES: sizes agree; at least 4 positions where there are no faces.
TangentDerivatives tangent_derivatives(std::span<const Vec3> positions, std::span<const Face> faces,
                                       std::span<const std::uint32_t> parents);

}  // namespace eigencast
