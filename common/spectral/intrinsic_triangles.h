// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "common/surface/surface.h"

namespace eigencast {

/// Lengths of a triangle's edges, each opposite to the corner of its number.
using EdgeLengths = std::array<double, 3>;

/// Heron's formula after Kahan, "Miscalculating Area and Angles of a Needle-like Triangle"; 0 where rounding breaks the
/// triangle inequality.
double area_from_lengths(EdgeLengths lengths);

/// Triangles that lie nowhere: what a cotangent matrix is assembled from. A corner may come twice in one.
struct IntrinsicTriangles {
  std::vector<Face> faces;
  std::vector<EdgeLengths> lengths;
  std::size_t flips = 0;
};

/// Whether any edge has three or more faces.
bool has_edge_of_many_faces(std::span<const Face> faces, std::size_t vertex_count);

/// The tufted cover of any triangles, its edges flipped until it is Delaunay (Sharp & Crane 2020, "A Laplacian for
/// Nonmanifold Triangle Meshes"; flips of lengths alone as of Fisher, Springborn, Bobenko, Schroeder 2006, "An
/// Algorithm for the Construction of Intrinsic Delaunay Triangulations"). Each face has two sides, and around an edge
/// each side goes on as the next that faces it: closed, manifold and oriented, whatever was given. Its matrices are
/// twice the surface's, and its weights not negative.
///   lengths  of the faces: at rest, or a little more, so that none is degenerate
/// REQUIRES: three different corners in each face. O(F log F) and the flips, at most 30 for each edge.
IntrinsicTriangles delaunay_cover(std::span<const Vec3> positions, std::span<const Face> faces,
                                  std::span<const EdgeLengths> lengths);

}  // namespace eigencast
