// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <cstddef>
#include <functional>
#include <utility>
#include <vector>

#include "common/core/result.h"
#include "common/surface/motion_clip.h"
#include "common/surface/surface.h"

namespace eigencast {

/// Columns that span a motion: each coordinate of every pose is a combination of them.
struct SpanningColumns {
  static constexpr std::size_t kMaxColumns = 2048;
  static constexpr std::size_t kMaxBytes = std::size_t{2} << 30;

  std::size_t count = 0;  ///< c
  std::vector<double> W;  ///< n x c, row-major; columns of equal effect have equal length.
};

/// Columns that span every pose of a rigged surface. With p the bind pose: w_j and w_j p for each bone j in use, and
/// w_j d for each morph target d that moves its vertices. p and d are about the bind pose's middle, in units of half
/// its diagonal. Errors: kTooLarge (more than SpanningColumns takes).
Result<SpanningColumns> columns_from_rig(const Rig& rig);

/// A surface's motion, for a basis that is made for it alone (build_motion_basis).
struct KnownMotion {
  /// Poses taken from a longer clip, evenly spaced.
  static constexpr std::size_t kMaxSamples = 4096;

  SpanningColumns columns;  ///< Empty: learn them from the poses.
  std::size_t poses = 0;
  /// Pose i (n x 3); may read a file and fail as MotionClip::pose does.
  std::function<Result<std::vector<Vec3>>(std::size_t)> pose;
  double rate_hz = 30;  ///< Poses a second; 30 where that is not between 0.1 and 1000.

  std::size_t samples() const { return std::min(poses, kMaxSamples); }
  Result<std::vector<Vec3>> sample(std::size_t i) const { return pose(i * poses / samples()); }
};

/// The poses of a clip, which must outlive the result.
inline KnownMotion motion_of(const MotionClip& clip, SpanningColumns columns = {}) {
  return {std::move(columns), clip.frame_count(), [&clip](std::size_t i) { return clip.pose(i); },
          clip.frame_rate_hz()};
}

}  // namespace eigencast
