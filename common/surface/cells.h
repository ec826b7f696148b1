// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/core/result.h"
#include "common/core/text.h"
#include "common/surface/surface.h"

namespace eigencast {

/// Cells of a solid; corners in VTK's order.
enum class CellKind : std::uint8_t { kTetrahedron, kHexahedron, kWedge, kPyramid };
inline constexpr EnumNames<CellKind, 4> kCellKindNames{{"tetra", "hexahedron", "wedge", "pyramid"}};
std::size_t corners_of(CellKind kind);

/// Triangles over some of a program's points.
struct PickedSurface {
  std::vector<std::uint32_t> vertices;  ///< Which points are meant, growing.
  std::vector<Face> faces;              ///< Number `vertices`.
};

/// Splits polygons into fans, always the same. Polygon i has the corners offsets[i] to offsets[i + 1] - 1 of
/// `connectivity`; those of fewer than three are left out. Errors: kInvalidArgument (offsets that fall, or do not begin
/// at 0 and end at the size of `connectivity`), kTooLarge.
Result<std::vector<Face>> fanned(std::span<const std::uint32_t> connectivity, std::span<const std::uint64_t> offsets);

/// The sides that only one cell has, facing away from its middle. Cells share a side where they name the same points.
///   cells  corners_of(kind) for each cell, all below points.size()
/// Errors: kInvalidArgument.
Result<PickedSurface> boundary_of(std::span<const Vec3> points, std::span<const std::uint32_t> cells, CellKind kind);

/// Joins each point to the first one within `tolerance` of it that is joined to none; 0: at the same place. Faces
/// without three corners left are dropped. O(n + F). Errors: kInvalidArgument, also for points that are not finite.
Result<PickedSurface> welded(const Surface& surface, double tolerance);

/// Hardly any two faces share a vertex, while vertices lie at one place: welded(), it would be a surface.
bool is_triangle_soup(const Surface& surface);

}  // namespace eigencast
