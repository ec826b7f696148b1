// SPDX-License-Identifier: MIT
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>

#include "common/surface/formats/file_text.h"
#include "common/surface/formats/guard.h"

namespace eigencast {
namespace {

using text::corrupt_at;
using text::quoted;

constexpr std::size_t kHeaderBytes = 84;  // 80 of comment, u32 count
constexpr std::size_t kTriangleBytes = 50;

std::uint32_t u32_at(std::string_view bytes, std::size_t offset) {
  std::uint32_t value = 0;
  for (std::size_t i = 0; i < 4; ++i) {
    value |= static_cast<std::uint32_t>(static_cast<unsigned char>(bytes[offset + i])) << (8 * i);
  }
  return value;
}

Result<GuardedMesh> guard_binary(std::string_view bytes, std::size_t triangles) {
  GuardedMesh mesh;
  mesh.binary = true;
  mesh.triangles = triangles;
  for (std::size_t t = 0; t < triangles; ++t) {
    for (std::size_t corner = 0; corner < 3; ++corner) {
      Vec3 p{};
      for (std::size_t c = 0; c < 3; ++c) {
        const std::size_t offset = kHeaderBytes + t * kTriangleBytes + 12 * (corner + 1) + 4 * c;
        p[c] = std::bit_cast<float>(u32_at(bytes, offset));
        if (!std::isfinite(p[c])) {
          return fail(ErrorCode::kCorrupt, "triangle " + std::to_string(t) + " has a coordinate that is not finite");
        }
      }
      mesh.positions.push_back(p);
    }
  }
  mesh.plain = bytes.substr(0, kHeaderBytes + triangles * kTriangleBytes);
  return mesh;
}

class TextStlGuard {
 public:
  explicit TextStlGuard(std::string_view bytes) : lines_(bytes) {}

  Result<GuardedMesh> run() {
    mesh_.plain = "solid\n";
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
    if (!complete_ || !corners_.empty()) return corrupt_at(lines_.number(), "the file ends before endsolid");
    mesh_.plain += "endsolid\n";
    return std::move(mesh_);
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
    std::string line = "vertex";
    for (double& coordinate : p) {
      const std::string_view token = next();
      const auto value = text::coordinate_from_token(token);
      if (!value) return corrupt_at(lines_.number(), "a vertex needs three finite numbers, not " + quoted(token));
      coordinate = *value;
      line.append(" ").append(token);
    }
    mesh_.positions.push_back(p);
    corners_.push_back(line + "\n");
    if (corners_.size() > 3) return corrupt_at(lines_.number(), "a facet of more than three corners");
    return {};
  }

  Result<void> end_facet() {
    if (corners_.size() != 3) {
      return corrupt_at(lines_.number(), "a facet of " + std::to_string(corners_.size()) + " corners");
    }
    mesh_.plain += "facet normal 0 0 0\nouter loop\n" + corners_[0] + corners_[1] + corners_[2] + "endloop\nendfacet\n";
    corners_.clear();
    ++mesh_.triangles;
    return {};
  }

  text::Lines lines_;
  std::string_view lines_rest_;
  std::vector<std::string> corners_;
  bool complete_ = false;
  GuardedMesh mesh_;
};

Result<GuardedMesh> guard_either(std::string_view bytes) {
  if (bytes.empty()) return fail(ErrorCode::kCorrupt, "the file is empty");
  const bool says_solid = bytes.substr(0, 5) == "solid" || bytes.substr(0, 5) == "SOLID";
  const std::size_t count = bytes.size() >= kHeaderBytes ? u32_at(bytes, kHeaderBytes - 4) : 0;
  const std::uint64_t binary_size = kHeaderBytes + std::uint64_t{count} * kTriangleBytes;
  // Binary files may start with "solid" too; then only a size that fits tells.
  if (bytes.size() >= kHeaderBytes && bytes.size() == binary_size) return guard_binary(bytes, count);
  if (says_solid) return TextStlGuard(bytes).run();
  if (bytes.size() < kHeaderBytes) return fail(ErrorCode::kCorrupt, "too short for an STL file");
  if (bytes.size() < binary_size) {
    return fail(ErrorCode::kCorrupt, "the header claims " + std::to_string(count) + " triangles, which are " +
                                         std::to_string(binary_size) + " bytes; the file has " +
                                         std::to_string(bytes.size()));
  }
  return guard_binary(bytes, count);
}

}  // namespace

Result<GuardedMesh> guard_stl(std::string_view bytes) {
  auto mesh = guard_either(bytes);
  if (!mesh) return mesh;
  if (const auto sizes = check_sizes(mesh->positions.size() / 3, mesh->triangles); !sizes) return sizes.error();
  return mesh;
}

}  // namespace eigencast
