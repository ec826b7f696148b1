// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "common/surface/surface.h"

namespace eigencast {

/// Notices frames of a clip that do not follow from the others: one that is out of place, vertices that changed their order.
/// Poses come one by one; two are kept, and 16 bytes for each frame. What counts as a jump is stated against what is usual in
/// this clip (the median of all steps) and against its size, so that fast motion is none. Not thread-safe.
class JumpFinder {
 public:
  /// Copies what it needs of the rest pose.
  explicit JumpFinder(const Surface& rest);
  /// The next frame. REQUIRES: as many positions as the rest pose has.
  void add(std::span<const Vec3> positions);

  /// A line for each frame that jumps, naming it, how far and which vertex most; at most `limit` lines, the last of which
  /// then says how many more there are. A clip of fewer than four frames says nothing about what is usual.
  std::vector<std::string> findings(std::size_t limit = 10) const;

 private:
  struct Step {
    float rms = 0;    ///< Displacement of all vertices since the frame before, in diagonals.
    float worst = 0;  ///< Of the one that moved farthest.
    std::uint32_t vertex = 0;
    float stretch = 1;  ///< Rms length of edges over the box' diagonal, relative to the rest pose.
  };
  float edge_length(std::span<const Vec3> positions) const;

  std::vector<Face> faces_;
  double diagonal_;
  float rest_edge_length_ = 0;
  std::vector<Vec3> before_;
  std::vector<Step> steps_;  ///< steps_[t] leads to frame t.
};

}  // namespace eigencast
