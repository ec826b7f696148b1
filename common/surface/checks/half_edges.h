// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <span>

#include "common/surface/surface.h"

namespace eigencast {

/// How far a mesh is from an oriented manifold.
struct Manifoldness {
  std::size_t boundary_edges = 0;        ///< Edges of exactly one face.
  std::size_t boundary_loops = 0;        ///< Walked along the faces: holes that touch in a vertex are one.
  std::size_t nonmanifold_edges = 0;     ///< Edges of three or more faces.
  std::size_t nonmanifold_vertices = 0;  ///< Vertices whose faces form more than one fan.
  std::size_t misoriented_edges = 0;     ///< Edges whose two faces run along them in the same direction.
};

/// By half-edges (OpenMesh's kernel, docs/adr/0007). Faces are turned until neighbours have one orientation; then the
/// surface is cut where half-edges cannot hold it: along edges of three or more faces, and a seam of each part that
/// cannot be oriented. Faces without three corners are left out; a cut edge joins fans, too. O(F log F).
Manifoldness manifoldness(std::span<const Face> faces, std::size_t vertex_count);

}  // namespace eigencast
