// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "common/surface/edge_uses.h"
#include "common/surface/surface.h"

namespace eigencast {

/// Faces that hang together along edges of exactly two faces.
struct OrientedPatches {
  std::vector<bool> turned;          ///< F: to turn, so that neighbours run along their edge in opposite directions.
  std::vector<std::uint32_t> patch;  ///< F: the number of its patch.
  std::uint32_t count = 0;
};
/// As far as that is possible; the first face of each patch stays. O(uses + F).
OrientedPatches oriented_patches(std::span<const EdgeUse> uses, std::size_t face_count);

/// The faces to turn where neighbours contradict one another, or a closed surface is wound inwards, in F; empty: none,
/// or it is a point cloud. Vertices at one position count as one. Each patch faces the side from which more rays leave
/// the surface, else the wider one, else that of most of its area (after Takayama et al. 2014, "A simple method
/// for correcting facet orientations in polygon meshes based on ray casting"). Always the same for the same surface. At
/// most 2^19 rays.
/// REQUIRES: check_values(surface).
std::vector<bool> faces_to_turn(const Surface& surface);

/// The same in place: corners 1 and 2 of these faces change places.
template <typename Corners>
void turn_faces(const std::vector<bool>& turned, std::vector<Corners>& faces) {
  for (std::size_t f = 0; f < turned.size() && f < faces.size(); ++f) {
    if (turned[f]) std::swap(faces[f][1], faces[f][2]);
  }
}

}  // namespace eigencast
