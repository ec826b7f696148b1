// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/surface/appearance.h"
#include "common/surface/surface.h"

namespace eigencast {

/// One colour for each vertex of an asset, linear RGB, n x 3, in the order of `source_vertex`: the mean over its corners of
/// the corner's colour, its material's, and that of the texture (PNG images) at its coordinates. Textures so become as coarse as
/// the mesh. Empty where the file states none of these, but for grey materials.
std::vector<float> own_colours(const Surface& surface, const Appearance& looks,
                               std::span<const std::uint32_t> source_vertex);

}  // namespace eigencast
