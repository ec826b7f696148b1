// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "common/surface/surface.h"

namespace eigencast {

using EdgeLengths = std::array<double, 3>;  ///< Belong to a triangle; edge i is opposite to corner i.

/// Heron's formula after Kahan, "Miscalculating Area and Angles of a Needle-like Triangle"; 0 where rounding breaks the
/// triangle inequality.
double area_from_lengths(EdgeLengths lengths);

/// Triangles by edge lengths alone, to assemble a cotangent matrix from. A triangle may contain a vertex twice.
struct IntrinsicTriangles {
  std::vector<Face> faces;
  std::vector<EdgeLengths> lengths;
  std::size_t flips = 0;
};

bool has_edge_of_many_faces(std::span<const Face> faces, std::size_t vertex_count);

/// The tufted cover of any triangles, its edges flipped until it is Delaunay (Sharp & Crane 2020, "A Laplacian for
/// Nonmanifold Triangle Meshes"; flips of lengths alone as of Fisher, Springborn, Bobenko, Schroeder 2006, "An
/// Algorithm for the Construction of Intrinsic Delaunay Triangulations"). Each face has two sides, glued around an edge
/// to the next side that faces it: the cover of any input is closed, manifold and oriented. Its matrices are twice the
/// surface's; its weights are not negative. O(F log F) plus the flips, at most 30 per edge.
/// REQUIRES: three different corners in each face; lengths mollified so that none is degenerate.
IntrinsicTriangles delaunay_cover(std::span<const Vec3> positions, std::span<const Face> faces,
                                  std::span<const EdgeLengths> lengths);

}  // namespace eigencast
