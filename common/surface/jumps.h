// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "common/surface/surface.h"

namespace eigencast {

/// Notices frames of a clip that do not follow from the others: one that is out of place, empty, in another unit or with its axes
/// exchanged, vertices that changed their order; and a rest pose whose faces are of another order of vertices. Poses come one by
/// one; two are kept, and 24 bytes for each frame. What counts as a jump is stated against what is usual in this clip (the median
/// of all steps) and against its size, so that fast motion is none. Not thread-safe.
class JumpFinder {
 public:
  /// Copies what it needs of the rest pose.
  explicit JumpFinder(const Surface& rest);
  /// The next frame. REQUIRES: as many positions as the rest pose has.
  void add(std::span<const Vec3> positions);

  /// A line for each frame that jumps, naming it, how far, which vertex most and the likely cause, and one for each row of frames of
  /// another order; at most `limit` lines, and one that says how many more frames there are. A clip of fewer than four frames says
  /// nothing about what is usual: only the order of its vertices is looked at.
  std::vector<std::string> findings(std::size_t limit = 10) const;

 private:
  struct Step {
    float rms = 0;    ///< Displacement of all vertices since the frame before, in diagonals.
    float worst = 0;  ///< Of the one that moved farthest.
    std::uint32_t vertex = 0;
    float stretch = 1;       ///< Rms length of edges over the box' diagonal, relative to the rest pose.
    float size = 1;          ///< Of the box, relative to the rest pose.
    bool exchanged = false;  ///< With its axes in another order it would be where the frame before was.
  };
  float edge_length(std::span<const Vec3> positions) const;
  enum class Jump : std::uint8_t { kNone, kSurface, kVertex, kTorn };
  std::vector<Jump> jumps() const;
  float usual_rms() const;
  std::string text_of(const Step& step, Jump kind) const;

  std::vector<Face> faces_;
  double diagonal_;
  float rest_edge_length_ = 0;
  bool scattered_ = false;  ///< The faces join vertices at random.
  std::vector<Vec3> before_;
  std::vector<Step> steps_;  ///< steps_[t] leads to frame t.
};

}  // namespace eigencast
