// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "common/surface/appearance.h"
#include "common/surface/surface.h"

namespace eigencast {

/// One colour for each vertex, sRGB, in the surface's order: its own, or the mean (of light) over its corners of the
/// corner's colour times its material's. Textures are no part of it. Empty where the file states no colours, or nothing
/// but one grey.
std::vector<std::array<std::uint8_t, 3>> stated_colours(const Surface& surface, const Appearance& looks);

/// The transfer of sRGB (IEC 61966-2-1), parts of 0 to 1.
float linear_from_srgb(float part);
float srgb_from_linear(float part);

}  // namespace eigencast
