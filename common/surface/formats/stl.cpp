// SPDX-License-Identifier: MIT
#include <array>
#include <cmath>
#include <cstdint>
#include <map>
#include <utility>

#include "common/surface/formats/binary_file.h"
#include "common/surface/formats/file_text.h"
#include "common/surface/formats/parsed_mesh.h"

namespace eigencast {
namespace {

using text::corrupt_at;
using text::quoted;

constexpr std::size_t kHeaderBytes = 84;  // 80 of comment, u32 count
constexpr std::size_t kTriangleBytes = 50;

using StlCorners = std::vector<Vec3>;

Result<StlCorners> corners_from_binary(std::string_view bytes, std::size_t triangles) {
  StlCorners corners;
  for (std::size_t t = 0; t < triangles; ++t) {
    for (std::size_t k = 0; k < 3; ++k) {
      Vec3 p{};
      for (std::size_t c = 0; c < 3; ++c) {
        const std::size_t offset = kHeaderBytes + t * kTriangleBytes + 12 * (k + 1) + 4 * c;
        p[c] = scalar_at<float>(bytes.data() + offset);
        if (!std::isfinite(p[c])) {
          return fail(ErrorCode::kCorrupt, "triangle " + std::to_string(t) + " has a coordinate that is not finite");
        }
      }
      corners.push_back(p);
    }
  }
  return corners;
}

class TextStlParser {
 public:
  explicit TextStlParser(std::string_view bytes) : lines_(bytes) {}

  Result<StlCorners> run() {
    for (std::string_view word = next(); !word.empty(); word = next()) {
      if (word == "vertex" || word == "VERTEX") {
        if (const auto taken = take_vertex(); !taken) return taken.error();
      } else if (word == "endfacet" || word == "ENDFACET") {
        if (const auto ended = end_facet(); !ended) return ended.error();
      } else if (word == "endsolid" || word == "ENDSOLID") {
        complete_ = true;
        lines_rest_ = {};  // its name may be anything
      } else if (word == "solid" || word == "SOLID") {
        complete_ = false;
        lines_rest_ = {};
      }
    }
    if (!complete_ || in_facet_ > 0) return corrupt_at(lines_.number(), "the file ends before endsolid");
    return std::move(corners_);
  }

 private:
  std::string_view next() {
    for (;;) {
      const std::string_view token = text::take_token(lines_rest_);
      if (!token.empty()) return token;
      const auto line = lines_.next();
      if (!line) return {};
      lines_rest_ = *line;
    }
  }

  Result<void> take_vertex() {
    Vec3 p{};
    for (double& coordinate : p) {
      const std::string_view token = next();
      const auto value = text::coordinate_from_token(token);
      if (!value) return corrupt_at(lines_.number(), "a vertex needs three finite numbers, not " + quoted(token));
      coordinate = *value;
    }
    corners_.push_back(p);
    if (++in_facet_ > 3) return corrupt_at(lines_.number(), "a facet of more than three corners");
    return {};
  }

  Result<void> end_facet() {
    if (in_facet_ != 3) return corrupt_at(lines_.number(), "a facet of " + std::to_string(in_facet_) + " corners");
    in_facet_ = 0;
    return {};
  }

  text::Lines lines_;
  std::string_view lines_rest_;
  StlCorners corners_;
  std::size_t in_facet_ = 0;  // corners
  bool complete_ = false;
};

Result<StlCorners> corners_from_stl(std::string_view bytes) {
  if (bytes.empty()) return fail(ErrorCode::kCorrupt, "the file is empty");
  const bool says_solid = bytes.substr(0, 5) == "solid" || bytes.substr(0, 5) == "SOLID";
  const std::size_t count =
      bytes.size() >= kHeaderBytes ? scalar_at<std::uint32_t>(bytes.data() + kHeaderBytes - 4) : 0;
  const std::uint64_t binary_size = kHeaderBytes + std::uint64_t{count} * kTriangleBytes;
  // Binary files may start with "solid" too; then only a size that fits decides.
  if (bytes.size() >= kHeaderBytes && bytes.size() == binary_size) return corners_from_binary(bytes, count);
  if (says_solid) return TextStlParser(bytes).run();
  if (bytes.size() < kHeaderBytes) return fail(ErrorCode::kCorrupt, "too short for an STL file");
  if (bytes.size() < binary_size) {
    return fail(ErrorCode::kCorrupt, "the header claims " + std::to_string(count) + " triangles, which are " +
                                         std::to_string(binary_size) + " bytes; the file has " +
                                         std::to_string(bytes.size()));
  }
  return corners_from_binary(bytes, count);
}

/// Triangles that share the vertices of equal 32-bit positions, numbered as they appear.
Surface shared_vertices(const StlCorners& corners) {
  using Position = std::array<float, 3>;
  const auto position = [&](std::size_t i) {
    // Adding 0 makes -0 and 0 one.
    return Position{static_cast<float>(corners[i][0]) + 0.0F, static_cast<float>(corners[i][1]) + 0.0F,
                    static_cast<float>(corners[i][2]) + 0.0F};
  };
  Surface surface;
  std::map<Position, std::uint32_t> numbers;
  for (std::size_t first = 0; first < corners.size(); first += 3) {
    Face face;
    for (std::size_t k = 0; k < 3; ++k) {
      const auto [at, is_new] =
          numbers.try_emplace(position(first + k), static_cast<std::uint32_t>(surface.positions.size()));
      const Vec3& p = corners[first + k];
      if (is_new) {
        surface.positions.push_back({static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2])});
      }
      face[k] = at->second;
    }
    if (face[0] != face[1] && face[1] != face[2] && face[2] != face[0]) surface.faces.push_back(face);
  }
  return surface;
}

}  // namespace

Result<ParsedMesh> parse_stl(std::string_view bytes) {
  const auto corners = corners_from_stl(bytes);
  if (!corners) return corners.error();
  if (const auto sizes = check_sizes(corners->size() / 3, corners->size() / 3); !sizes) return sizes.error();
  return ParsedMesh{shared_vertices(*corners)};
}

}  // namespace eigencast
