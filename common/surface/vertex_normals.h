// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/surface/appearance.h"
#include "common/surface/surface.h"

namespace eigencast {

/// Finds where a file's own normals agree, corner by corner. O(1) for each, 16 bytes a vertex.
class VertexNormalsFinder {
 public:
  /// Below, normals are one: exporters round them.
  static constexpr double kMaxAngleDeg = 1;

  explicit VertexNormalsFinder(std::size_t vertices) : first_(vertices), found_(vertices, Found::kNothing) {}

  /// A face's corner at `vertex`; a normal that is not finite, or has no length, is none. Its length does not count.
  void add_corner(std::uint32_t vertex, const Vec3& normal);
  /// One for each vertex; empty: the file has no normals, or the same at every corner, which says nothing.
  std::vector<VertexNormals> take() const;

 private:
  enum class Found : std::uint8_t { kNothing, kOne, kSeveral, kGap };

  std::vector<std::array<float, 3>> first_;  // of each vertex
  std::vector<Found> found_;
  std::array<float, 3> any_{};
  bool has_any_ = false, has_two_ = false;
};

}  // namespace eigencast
