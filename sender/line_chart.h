// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "view/picture.h"

namespace eigencast {

/// Lines over numbered axes.
struct LineChart {
  struct Line {
    std::string name;
    std::vector<std::pair<double, double>> points;  ///< x, y in the order in which they are joined.
  };
  std::string title, x_label, y_label;
  bool log_x = false, log_y = false;  ///< Values that are not above zero are then left out.
  std::vector<Line> lines;
};

/// The numbers that an axis from `low` to `high` is marked with: 3 to 12 round ones within, ascending (low < high; both
/// above 0 where it is logarithmic).
std::vector<double> axis_marks(double low, double high, bool logarithmic);

/// 1200 x 720 pixels. Without a point that can be drawn, the axes run from 0.1 to 1.
Picture picture_of(const LineChart& chart);

}  // namespace eigencast
