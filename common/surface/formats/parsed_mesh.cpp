// SPDX-License-Identifier: MIT
#include "common/surface/formats/parsed_mesh.h"

#include <algorithm>
#include <cmath>

namespace eigencast {

void add_fan(std::span<const std::uint32_t> corners, std::vector<Face>& faces) {
  for (std::size_t k = 2; k < corners.size(); ++k) faces.push_back({corners[0], corners[k - 1], corners[k]});
}

Result<void> check_sizes(std::size_t vertices, std::size_t triangles) {
  if (vertices == 0) return fail(ErrorCode::kCorrupt, "no vertices in it");
  if (vertices > kMaxSurfaceVertices || triangles > kMaxSurfaceFaces) {
    return fail(ErrorCode::kTooLarge, std::to_string(vertices) + " vertices and " + std::to_string(triangles) +
                                          " triangles; the limits are " + std::to_string(kMaxSurfaceVertices) +
                                          " and " + std::to_string(kMaxSurfaceFaces));
  }
  return {};
}

std::array<std::uint8_t, 3> colour_from_parts(const std::array<double, 3>& parts) {
  std::array<std::uint8_t, 3> colour{};
  for (std::size_t c = 0; c < 3; ++c)
    colour[c] = static_cast<std::uint8_t>(std::lround(255 * std::clamp(parts[c], 0.0, 1.0)));
  return colour;
}

Result<void> check_corners(std::uint64_t corners, std::size_t line) {
  if (corners >= 3 && corners <= kMaxCorners) return {};
  const std::string where = line > 0 ? "line " + std::to_string(line) + ": " : "";
  return fail(
      corners < 3 ? ErrorCode::kCorrupt : ErrorCode::kTooLarge,
      where + "a face of " + std::to_string(corners) + " corners; 3 to " + std::to_string(kMaxCorners) + " can be");
}

Result<ParsedMesh> finished(ParsedMesh mesh) {
  const Surface& surface = mesh.surface;
  if (const auto sizes = check_sizes(surface.vertex_count(), surface.faces.size()); !sizes) return sizes.error();
  if (mesh.colours.size() != surface.vertex_count()) mesh.colours.clear();
  return mesh;
}

}  // namespace eigencast
