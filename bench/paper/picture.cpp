// SPDX-License-Identifier: MIT
#include "bench/paper/picture.h"

#include <png.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace eigencast::bench {
namespace {

constexpr double kYaw = 0.6, kPitch = 0.3;  // of the view, radians
constexpr double kSplat = 1.6;              // pixels

/// Into the view's axes: x right, y up, z towards the viewer.
Vec3 seen(const Vec3& p) {
  const double x = std::cos(kYaw) * p[0] + std::sin(kYaw) * p[2], z = -std::sin(kYaw) * p[0] + std::cos(kYaw) * p[2];
  return {x, std::cos(kPitch) * p[1] - std::sin(kPitch) * z, std::sin(kPitch) * p[1] + std::cos(kPitch) * z};
}

double shade_of(const Vec3& normal) {
  const double light = std::abs(0.35 * normal[0] + 0.5 * normal[1] + 0.79 * normal[2]);
  return 40 + 190 * std::min(1.0, light);
}

}  // namespace

Sheet::Sheet(int columns, int rows, int cell_width, int cell_height)
    : cell_width_(cell_width),
      cell_height_(cell_height),
      width_(columns * cell_width),
      height_(rows * cell_height),
      grey_(static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_), 255),
      depth_(grey_.size(), -std::numeric_limits<double>::infinity()) {}

void Sheet::put(int column, int row, double x, double y, double depth, double shade) {
  const int px = static_cast<int>(std::floor(x)), py = static_cast<int>(std::floor(y));
  if (px < 0 || py < 0 || px >= cell_width_ || py >= cell_height_) return;
  const std::size_t at = static_cast<std::size_t>(row * cell_height_ + py) * static_cast<std::size_t>(width_) +
                         static_cast<std::size_t>(column * cell_width_ + px);
  if (depth <= depth_[at]) return;
  depth_[at] = depth;
  grey_[at] = static_cast<std::uint8_t>(std::clamp(shade, 0.0, 255.0));
}

void Sheet::draw(int column, int row, const Surface& surface, std::span<const Vec3> normals, double scale,
                 const Vec3& centre) {
  struct Corner {
    double x, y, depth, shade;
  };
  std::vector<Corner> corners;
  corners.reserve(surface.vertex_count());
  for (std::size_t i = 0; i < surface.vertex_count(); ++i) {
    Vec3 p = surface.positions[i];
    for (std::size_t c = 0; c < 3; ++c) p[c] = scale * (p[c] - centre[c]);
    const Vec3 q = seen(p);
    corners.push_back({cell_width_ / 2.0 + q[0], cell_height_ / 2.0 - q[1], q[2], shade_of(seen(normals[i]))});
  }
  if (surface.is_point_cloud()) {
    for (const Corner& c : corners) {
      for (double dy = -kSplat; dy <= kSplat; dy += 0.8) {
        for (double dx = -kSplat; dx <= kSplat; dx += 0.8) {
          if (dx * dx + dy * dy <= kSplat * kSplat) put(column, row, c.x + dx, c.y + dy, c.depth, c.shade);
        }
      }
    }
    return;
  }
  for (const Face& f : surface.faces) {
    const Corner &a = corners[f[0]], &b = corners[f[1]], &c = corners[f[2]];
    const double area = (b.x - a.x) * (c.y - a.y) - (c.x - a.x) * (b.y - a.y);
    if (area == 0) continue;
    const double low_x = std::floor(std::min({a.x, b.x, c.x})), high_x = std::ceil(std::max({a.x, b.x, c.x}));
    const double low_y = std::floor(std::min({a.y, b.y, c.y})), high_y = std::ceil(std::max({a.y, b.y, c.y}));
    for (double y = low_y + 0.5; y < high_y; ++y) {
      for (double x = low_x + 0.5; x < high_x; ++x) {
        const double v = ((x - a.x) * (c.y - a.y) - (c.x - a.x) * (y - a.y)) / area;
        const double w = ((b.x - a.x) * (y - a.y) - (x - a.x) * (b.y - a.y)) / area;
        const double u = 1 - v - w;
        if (u < 0 || v < 0 || w < 0) continue;
        put(column, row, x, y, u * a.depth + v * b.depth + w * c.depth, u * a.shade + v * b.shade + w * c.shade);
      }
    }
  }
}

bool Sheet::write_png(const std::string& path) const {
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  image.width = static_cast<png_uint_32>(width_);
  image.height = static_cast<png_uint_32>(height_);
  image.format = PNG_FORMAT_GRAY;
  return png_image_write_to_file(&image, path.c_str(), 0, grey_.data(), 0, nullptr) != 0;
}

}  // namespace eigencast::bench
