// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <string>

#include "common/surface/surface.h"

namespace eigencast {

/// What is unusual about a surface. For a point cloud only the vertex counts are set.
struct SurfaceReport {
  std::size_t vertices = 0;
  std::size_t faces = 0;
  std::size_t components = 0;          ///< Connected by faces; unreferenced vertices are not counted.
  std::size_t duplicate_vertices = 0;  ///< Vertices at a position that an earlier vertex has (equal doubles).
  std::size_t unreferenced_vertices = 0;
  std::size_t degenerate_faces = 0;      ///< Repeated corners or no area (below 1e-14 of the squared diagonal).
  std::size_t duplicate_faces = 0;       ///< The same three corners as an earlier face.
  std::size_t boundary_edges = 0;        ///< Edges of exactly one face.
  std::size_t boundary_loops = 0;        ///< Walked along the faces: holes that touch in a vertex are one.
  std::size_t nonmanifold_edges = 0;     ///< Edges of three or more faces.
  std::size_t nonmanifold_vertices = 0;  ///< Vertices whose faces form more than one fan.
  std::size_t misoriented_edges = 0;     ///< Edges whose two faces run along them in the same direction.
  bool closed() const { return faces > 0 && boundary_edges == 0 && nonmanifold_edges == 0; }
};

/// Takes any surface: faces with a repeated or out-of-range corner are degenerate and join nothing. O(n log n).
SurfaceReport check_surface(const Surface& surface);

std::string text_from_report(const SurfaceReport& report);

}  // namespace eigencast
