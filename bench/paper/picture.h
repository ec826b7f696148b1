// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "common/surface/surface.h"

namespace eigencast::bench {

/// A sheet of shaded views, drawn without a GPU. Grey surfaces on white, seen along -z from the front.
class Sheet {
 public:
  Sheet(int columns, int rows, int cell_width, int cell_height);
  /// Draws a mesh, or points as discs, into a cell; `scale` pixels to a model unit, `centre` in the cell's middle.
  ///   normals  n x 3, by vertex; either side may face the viewer
  void draw(int column, int row, const Surface& surface, std::span<const Vec3> normals, double scale,
            const Vec3& centre);
  /// False where the file cannot be written.
  bool write_png(const std::string& path) const;

 private:
  void put(int column, int row, double x, double y, double depth, double shade);
  int cell_width_, cell_height_, width_, height_;
  std::vector<std::uint8_t> grey_;
  std::vector<double> depth_;
};

}  // namespace eigencast::bench
