// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string_view>

namespace eigencast {

/// Colours of numbers. All but turbo are perceptually even: lightness grows steadily or, of coolwarm, falls evenly from
/// the middle. viridis and cividis are safe for the colour-blind.
enum class ColourMap { kViridis, kCividis, kCoolwarm, kTurbo, kGrey };
inline constexpr int kColourMaps = 5;

std::string_view name_of(ColourMap map);
std::optional<ColourMap> colour_map_from_name(std::string_view name);

/// From the lowest value to the highest, sRGB. Smith, van der Walt 2015 (viridis); Nunez, Anderton, Renslow 2018
/// (cividis); Moreland 2009, "Diverging color maps for scientific visualization" (coolwarm); Mikhailov 2019 (turbo).
using ColourTable = std::array<std::array<std::uint8_t, 3>, 256>;
ColourTable table_of(ColourMap map);

}  // namespace eigencast
