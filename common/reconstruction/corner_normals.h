// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "common/asset/asset.h"
#include "common/reconstruction/level_morph.h"

namespace eigencast {

/// How a vertex has normals: one; one for each group of the faces around it that meet in no edge that bends by a given
/// angle; the same where its faces' normals are known to differ, so that edges count that bend by half as much as the
/// sharpest one there, too.
enum class Parting : std::uint8_t { kNone, kByAngle, kKnown };

/// The normals of vertices that have several, at every level of detail. Normals are numbered: v is the first of vertex
/// v, n + e extra number e. They contract as vertices do: at a level a corner has the normal that is found from its own
/// by following `parent` until its origin is there, so that sides of an edge stay apart, and levels morph.
class CornerNormals final {
 public:
  /// Of all vertices that have arrived, with their faces, by death.
  struct Whole {
    std::uint32_t vertices = 0;  ///< n, of the finished asset.
    std::uint32_t base = 0;
    std::span<const std::uint32_t> map;  ///< A row each.
    std::span<const Corners> faces;      ///< With corners below map.size().
    std::span<const std::uint32_t> death;
    std::span<const float> rest;  ///< Positions, three for each row.
  };

  CornerNormals() = default;
  /// Two faces at an edge are in one group if they bend by less and run the same way round; an edge of more faces parts
  /// them all, and faces without area have the vertex' first normal. O(n + F).
  ///   partings  one for each row, or fewer: kNone
  ///   cosine    of the angle
  CornerNormals(const Whole& whole, std::span<const Parting> partings, double cosine);

  bool empty() const { return origins_.empty(); }
  std::uint32_t vertices() const { return vertices_; }
  /// The vertices that extras are of, ascending: of those below N.
  std::span<const std::uint32_t> origins(std::uint32_t N = std::numeric_limits<std::uint32_t>::max()) const {
    const auto end = std::lower_bound(origins_.begin(), origins_.end(), N);
    return {origins_.data(), static_cast<std::size_t>(end - origins_.begin())};
  }
  std::span<const std::uint32_t> parents() const { return parents_; }  ///< n + extras; of the base: themselves.
  std::uint32_t origin(std::uint32_t normal) const {
    return normal < vertices_ ? normal : origins_[normal - vertices_];
  }
  bool parts(std::uint32_t vertex) const { return parts_[vertex] != 0; }  ///< It has several.

  /// The normal of a corner (3 x face + corner), which is this vertex at the level.
  std::uint32_t at(std::size_t corner, std::uint32_t vertex) const {
    if (!parts(vertex)) return vertex;
    std::uint32_t normal = corners_[corner];
    while (origin(normal) > vertex) normal = parents_[normal];
    return normal;
  }

  /// As LevelMorph::share(), of the sums of normals over faces by area_normals().
  void share(const LevelMorph& level, std::span<float> sums, std::span<float> extras) const;

 private:
  void group(const Whole& whole, std::span<const Parting> partings, double cosine);
  void contract(const Whole& whole);

  std::uint32_t vertices_ = 0;
  std::vector<std::uint32_t> corners_;  ///< 3 F
  std::vector<std::uint32_t> origins_, parents_;
  std::vector<std::uint8_t> parts_;
};

}  // namespace eigencast
