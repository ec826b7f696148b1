// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <optional>
#include <string>

#include "view/colour_map.h"
#include "view/paint.h"

namespace eigencast {

/// How the scene is drawn: what the user has chosen, in the window or on the command line.
struct Look {
  bool edges = false, wireframe = false, points = false, grid = true, axes = false;
  bool transparent = false;  ///< Pictures that are written have no wall behind the scene.
  bool legend = true;        ///< Where there is one to show.
  SurfacePainter::Wish colour;
  ColourMap colour_map = ColourMap::kViridis;
  std::optional<std::array<float, 2>> colour_range;  ///< Nothing: as the values seen so far.
};

/// The colours' meaning, as it is shown beside the surface.
struct Legend {
  std::string title, unit;
  float low = 0, high = 1;
  ColourMap map = ColourMap::kViridis;
  bool operator==(const Legend&) const = default;
};

}  // namespace eigencast
