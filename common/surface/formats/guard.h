// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "common/core/result.h"
#include "common/surface/surface.h"

/// What stands between hostile bytes and OpenMesh. Private to common/surface.
///
/// OpenMesh's readers trust a file: they take header counts at their word, run on after a token that is no number,
/// assert on a face without vertices, skip vertices that they cannot parse (which renumbers the others), follow an
/// OBJ's mtllib to any path, and print. A guard checks a file against its format first, names what is wrong and where,
/// and rewrites it as the plain subset of the format that those readers are safe on: vertices and faces, nothing else.
namespace eigencast {

struct GuardedMesh {
  std::string plain;                                   ///< The file for OpenMesh.
  std::vector<Vec3> positions;                         ///< As the file states them: OpenMesh holds 32-bit floats.
  std::vector<std::array<std::uint8_t, 3>> colours{};  ///< sRGB; as many as positions, or none.
  std::vector<std::array<std::array<float, 2>, 3>>
      corner_uv{};              ///< A triangle each, or none; NaN: nowhere in the image.
  std::vector<int> material{};  ///< A triangle each, of material_names; -1: none.
  std::vector<std::string> material_names{}, material_files{};  ///< As the file calls them.
  std::size_t triangles = 0;                                    ///< After splitting n-gons in fans.
  bool binary = false;                                          ///< How STL's `plain` is to be read.
};

/// Each takes the bytes of a file. Errors: kCorrupt, kUnsupported, kTooLarge; the caller adds the file's name.
Result<GuardedMesh> guard_obj(std::string_view bytes);
Result<GuardedMesh> guard_off(std::string_view bytes);
Result<GuardedMesh> guard_ply(std::string_view bytes);
/// positions: three per triangle.
Result<GuardedMesh> guard_stl(std::string_view bytes);

/// A colour stated in parts of 0 to 1, sRGB; what lies outside becomes the nearest.
std::array<std::uint8_t, 3> colour_from_parts(const std::array<double, 3>& parts);

/// Colours stand for all vertices or for none.
void drop_partial_colours(GuardedMesh& mesh);

/// Limits and emptiness, the same for all formats.
Result<void> check_sizes(std::size_t vertices, std::size_t triangles);

/// OpenMesh looks for repeated corners in quadratic time, so a face has at most this many.
inline constexpr std::uint64_t kMaxCorners = 4096;

/// 3 to kMaxCorners; `line` is 0 where there are no lines.
Result<void> check_corners(std::uint64_t corners, std::size_t line);

}  // namespace eigencast
