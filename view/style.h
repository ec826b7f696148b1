// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>

#include "common/core/text.h"
#include "view/paint.h"

namespace eigencast {

/// Colours of numbers. All but turbo are perceptually even: lightness grows steadily or, of coolwarm, falls evenly from
/// the middle. viridis and cividis are safe for the colour-blind.
enum class ColourMap { kViridis, kCividis, kCoolwarm, kTurbo, kGrey };
inline constexpr int kColourMaps = 5;

inline constexpr EnumNames<ColourMap, kColourMaps> kColourMapNames{{"viridis", "cividis", "coolwarm", "turbo", "grey"}};

/// Runs from the lowest value to the highest, sRGB. Smith, van der Walt 2015 (viridis); Nunez, Anderton, Renslow 2018
/// (cividis); Moreland 2009, "Diverging color maps for scientific visualization" (coolwarm); Mikhailov 2019 (turbo).
using ColourTable = std::array<std::array<std::uint8_t, 3>, 256>;
ColourTable table_of(ColourMap map);

struct DrawStyle : Shading {
  bool edges = false, wireframe = false, points = false, grid = true, axes = false;
  bool transparent = false;  ///< No wall, no grid: what is drawn keeps its alpha, the floor only its shadow.
  ColourMap colour_map = ColourMap::kViridis;  ///< For surfaces painted with numbers.
};

/// How the key light's shadow is drawn: blurred from a large map, from a small one with fewer taps, or not at all.
enum class ShadowQuality { kFull, kSmall, kNone };

/// What a picture may do without, to be in time.
struct PictureQuality {
  static constexpr float kMinScale = 0.5F, kMaxScale = 1.414F;
  float scale = 1;  ///< Pixels drawn to one shown, along each side; kMinScale to kMaxScale.
  int samples = 4;  ///< Of each pixel drawn, as far as the driver gives them; >= 1.
  ShadowQuality shadow = ShadowQuality::kFull;
  bool ground = true;  ///< The floor, with grid and shadow.
  bool operator==(const PictureQuality&) const = default;
};

struct Style : DrawStyle {
  bool legend = true;  ///< Where there is one to show.
  SurfacePainter::Wish colour;
  std::optional<std::array<float, 2>> colour_range;  ///< Default: the values seen so far.
};

struct Legend {
  std::string title, unit;
  float low = 0, high = 1;
  ColourMap map = ColourMap::kViridis;
  bool operator==(const Legend&) const = default;
};

}  // namespace eigencast
