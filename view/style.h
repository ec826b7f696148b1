// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <optional>
#include <string>

#include "view/colour_map.h"
#include "view/paint.h"

namespace eigencast {

struct DrawStyle {
  bool edges = false, wireframe = false, points = false, grid = true, axes = false;
  bool transparent = false;  ///< No wall, no grid: what is drawn keeps its alpha, the floor only its shadow.
  ColourMap colour_map = ColourMap::kViridis;  ///< For surfaces painted with numbers.
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
