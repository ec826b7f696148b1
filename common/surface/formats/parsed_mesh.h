// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "common/core/result.h"
#include "common/surface/appearance.h"
#include "common/surface/surface.h"

/// OBJ, OFF, PLY and STL as arrays. Private to common/surface.
/// Files are hostile: counts are held against the size of the file before allocation, indices against the vertices, and
/// every number must be finite. Nothing is merged or dropped but in STL, which has no indices.
namespace eigencast {

struct ParsedMesh {
  Surface surface;
  std::vector<std::array<std::uint8_t, 3>> colours{};            ///< sRGB; as many as positions, or none.
  std::vector<VertexNormals> normals{};                          ///< As many, or none.
  std::vector<std::array<std::array<float, 2>, 3>> corner_uv{};  ///< A triangle each, or none; NaN: no UV.
  std::vector<int> material{};                                   ///< A triangle each, of material_names; -1: none.
  std::vector<std::string> material_names{}, material_files{};   ///< As the file calls them.
};

/// Errors: kCorrupt, kUnsupported, kTooLarge; the caller adds the file's name.
Result<ParsedMesh> parse_obj(std::string_view bytes);
Result<ParsedMesh> parse_off(std::string_view bytes);
Result<ParsedMesh> parse_ply(std::string_view bytes);
/// Triangles share a vertex where they have the same 32-bit position; those without three corners left are dropped.
Result<ParsedMesh> parse_stl(std::string_view bytes);

/// Replaces `appearance` by the UVs of the corners and the materials' colours (Kd) and images (map_Kd). Opens files
/// below the folder of `path` only; those that are absent, elsewhere or over 16 MiB leave their material white and
/// their image empty, and appearance.missing says so.
void add_obj_appearance(const ParsedMesh& mesh, const std::string& path, Appearance& appearance);

/// Splits a polygon into a fan of triangles. REQUIRES: three corners or more.
void add_fan(std::span<const std::uint32_t> corners, std::vector<Face>& faces);

/// A colour stated in parts of 0 to 1, sRGB; what lies outside becomes the nearest.
std::array<std::uint8_t, 3> colour_from_parts(const std::array<double, 3>& parts);

Result<void> check_sizes(std::size_t vertices, std::size_t triangles);

/// check_sizes() of what was read; colours that not all vertices have are dropped.
Result<ParsedMesh> finished(ParsedMesh mesh);

inline constexpr std::uint64_t kMaxCorners = 4096;  ///< One face has no more.

/// 3 to kMaxCorners; `line` is 0 where there are no lines.
Result<void> check_corners(std::uint64_t corners, std::size_t line);

}  // namespace eigencast
