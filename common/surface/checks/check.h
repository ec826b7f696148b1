// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <string>

#include "common/surface/checks/half_edges.h"
#include "common/surface/surface.h"

namespace eigencast {

/// What is unusual about a surface. For a point cloud only the vertex counts are set.
struct SurfaceReport : Manifoldness {
  std::size_t vertices = 0;
  std::size_t faces = 0;
  std::size_t components = 0;          ///< Connected by faces; unreferenced vertices are not counted.
  std::size_t duplicate_vertices = 0;  ///< Vertices at a position that an earlier vertex has (equal doubles).
  std::size_t unreferenced_vertices = 0;
  std::size_t degenerate_faces = 0;  ///< Repeated corners or no area (below 1e-14 of the squared diagonal).
  std::size_t duplicate_faces = 0;   ///< The same three corners as an earlier face.
  bool closed() const { return faces > 0 && boundary_edges == 0 && nonmanifold_edges == 0; }
};

/// Faces with a repeated or out-of-range corner count as degenerate and join nothing. Any surface may be given.
/// O(n log n).
SurfaceReport check_surface(const Surface& surface);

/// For people, in lines.
std::string text_from_report(const SurfaceReport& report);

}  // namespace eigencast
