// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "common/surface/surface.h"

namespace eigencast {

/// Of more faces neither creases nor hard edges are sought: none is wider than a pixel there, and the time would show.
inline constexpr std::size_t kMaxCreasedFaces = 1'000'000;

/// For each vertex the largest angle in radians by which two faces bend away from one another along an edge that ends
/// there; 0 where no edge has two faces with an area, pi where one has more. Winding does not count.
///   positions  n x 3
///   is_solid   if given: whether the faces enclose a volume, each edge being one of two that run against each other,
///              and look outwards
/// REQUIRES: faces within them.
std::vector<float> crease_angles(std::span<const Face> faces, std::span<const float> positions,
                                 bool* is_solid = nullptr);

}  // namespace eigencast
