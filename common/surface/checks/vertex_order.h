// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "common/surface/surface.h"

namespace eigencast {

std::string percent_text(float part);  ///< "5.0 %", "42 %".

struct Misfit {
  enum class Kind : std::uint8_t {
    kNone,
    kVertex,     ///< Vertices are far from their neighbours.
    kInsideOut,  ///< The surface is mirrored.
    kOrder,      ///< Faces join vertices that are not neighbours: the order of vertices is another.
  };
  Kind kind = Kind::kNone;
  bool certain = false;      ///< kOrder: no deformation of the surface can cause it.
  std::uint32_t vertex = 0;  ///< The farthest from its neighbours.
  std::uint32_t others = 0;  ///< How many more are far from theirs.
  float away = 0;            ///< How far, of the diagonal.
  float folded = 0;          ///< Part of the edges whose two faces lie on each other.
  float stretch = 1;  ///< Rms length of edges, relative to the rest pose: as it is or over the box, whichever is less.

  std::string text() const;  ///< What, and the likely cause. REQUIRES: kind is not kNone.
};

/// Decides by neighbours alone whether a pose's vertices are in the order of the rest pose's faces, however the surface
/// is moved, scaled or bent: two faces that meet in an edge seldom lie on each other (less than 107 degrees apart: one
/// edge of a hundred, every second where faces join vertices at random); edges do not become many times as long while
/// the surface stays as large; a vertex lies about in the middle of its neighbours. Lengths are compared with those of
/// edges nearby, so that no even stretch matters. Thread-safe after construction.
class VertexOrder {
 public:
  /// Copies what it needs, of two million faces at most. Without faces everything fits.
  explicit VertexOrder(const Surface& rest);

  const Misfit& rest() const { return rest_; }  ///< Judges the rest pose itself: kNone or kOrder.
  /// REQUIRES: as many positions as the rest pose has. O(n + F).
  Misfit check(std::span<const Vec3> positions) const;

 private:
  /// Mean length of a vertex's edges, of its neighbours' other edges, and its distance from its neighbours' mean.
  struct Local {
    float incident = 0, ring = 0, off = 0;
  };
  std::vector<Local> locals(std::span<const Vec3> positions) const;
  void find_strays(std::span<const Vec3> positions, Misfit& misfit) const;
  float folded(std::span<const Vec3> positions) const;
  float stretch(std::span<const Vec3> positions) const;
  double edge_length(std::span<const Vec3> positions) const;
  /// Volume over area^1.5, which no scale changes; 0 of surfaces that are not closed.
  double fullness(std::span<const Vec3> positions) const;

  std::vector<Face> faces_;
  std::vector<std::pair<std::uint32_t, std::uint32_t>> edges_;  ///< Join vertices.
  std::vector<std::pair<std::uint32_t, std::uint32_t>>
      face_pairs_;                     ///< That meet in an edge and have the same orientation.
  std::vector<std::uint32_t> degree_;  ///< n
  std::vector<Local> at_rest_;         ///< n
  double diagonal_;
  double edge_length_ = 0;  ///< Rms.
  double fullness_ = 0;
  Misfit rest_;
};

}  // namespace eigencast
