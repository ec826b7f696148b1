// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "common/core/result.h"
#include "common/surface/checks/vertex_order.h"
#include "common/surface/surface.h"

namespace eigencast {

/// Notices frames that do not follow from the others: out of place, empty, in another unit or with their axes
/// exchanged, with vertices out of place or in another order (see VertexOrder); and a rest pose whose faces are of
/// another order. Poses come one by one; four are kept, and 20 bytes for each frame. What jumps is stated against the
/// median of all steps and the surface's size. Not thread-safe.
class JumpFinder {
 public:
  explicit JumpFinder(const Surface& rest);
  void add(std::span<const Vec3> positions);  ///< REQUIRES: as many as the rest pose has.

  enum class Cause : std::uint8_t { kOrder, kInsideOut, kStray, kVertex, kEmpty, kUnit, kAxes, kPosition };
  struct Finding {
    std::size_t first = 0, last = 0;  ///< Frames.
    Cause cause = Cause::kPosition;   ///< The likely one.
    std::string text;                 ///< How far, which vertex most, the likely cause; for people.
  };
  /// One for each frame that jumps, and for each row of frames with the same misfit. Clips of fewer than four frames
  /// are compared with the rest pose, and their positions with each other.
  std::vector<Finding> found() const;

  std::vector<std::string> findings(std::size_t limit = 10) const;  ///< A line each, and one for those beyond.

  std::string rest_finding() const;  ///< What is wrong with the rest pose, in a line; empty: nothing.

  /// Errors: kInvalidArgument where the rest pose, or more than half of the frames, certainly are in another order.
  Result<void> order() const;

 private:
  struct Step {
    float rms = 0;    ///< Displacement of all vertices since the frame before, in diagonals.
    float worst = 0;  ///< Belongs to the one that moved farthest.
    std::uint32_t vertex = 0;
    float size = 1;          ///< The box's, relative to the rest pose.
    bool exchanged = false;  ///< With its axes in another order it would be where the frame before was.
  };
  enum class Jump : std::uint8_t { kNone, kSurface, kVertex, kMisfit };
  std::vector<Jump> jumps() const;
  const Misfit* misfit_of(std::size_t frame) const;
  bool is_same_misfit(std::size_t frame, std::size_t other) const;
  /// Which of exactly three frames is far from the two others; the number of frames: none.
  std::size_t lonely_of_three() const;
  float usual_rms() const;
  Finding explained(std::size_t frame, Jump kind) const;

  VertexOrder order_;
  double diagonal_;
  std::vector<Vec3> before_;
  std::vector<Step> steps_;                                ///< steps_[t] leads to frame t.
  std::vector<std::pair<std::uint32_t, Misfit>> misfits_;  ///< By frame, of those that have one.
  std::vector<Vec3> centres_;                              ///< Belong to the first three frames' boxes.
};

}  // namespace eigencast
