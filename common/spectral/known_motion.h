// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <functional>
#include <utility>
#include <vector>

#include "common/core/result.h"
#include "common/surface/motion_clip.h"
#include "common/surface/surface.h"

namespace eigencast {

/// What poses are made of: each coordinate of every pose is W times some numbers.
struct SpanningColumns {
  static constexpr std::size_t kMost = 2048;
  static constexpr std::size_t kMostBytes = std::size_t{2} << 30;

  std::size_t count = 0;  ///< c
  std::vector<double> W;  ///< n x c, row-major; columns that move a surface alike are as long as each other.
};

/// What is known of how a surface moves, for a basis that is made for this motion alone (motion_basis.h).
struct KnownMotion {
  /// Of a longer clip so many poses, evenly spaced, say what matters.
  static constexpr std::size_t kMostSamples = 4096;

  SpanningColumns columns;  ///< Empty: not known, and learned from the poses.
  std::size_t poses = 0;
  /// Pose i (n x 3) of those; may read a file, and fail as MotionClip::pose does.
  std::function<Result<std::vector<Vec3>>(std::size_t)> pose;

  std::size_t samples() const { return poses < kMostSamples ? poses : kMostSamples; }
  Result<std::vector<Vec3>> sample(std::size_t i) const { return pose(i * poses / samples()); }
};

/// The poses of a clip, which must outlive what is returned.
inline KnownMotion motion_of(const MotionClip& clip, SpanningColumns columns = {}) {
  return {std::move(columns), clip.frame_count(), [&clip](std::size_t i) { return clip.pose(i); }};
}

}  // namespace eigencast
