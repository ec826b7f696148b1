// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <functional>
#include <string>

#include "common/core/result.h"
#include "common/surface/appearance.h"
#include "common/surface/surface.h"

/// Recorded poses, and vertex caches of content creation programs. Private to common/surface.
///   PC2 (little-endian)   char[12] "POINTCACHE2\0", i32 version 1, i32 points, f32 first frame, f32 frames between two
///                         samples, i32 samples; then samples x points x (f32 x, y, z)
///   MDD (big-endian)      i32 frames, i32 points, f32 time in seconds for each frame; then frames x points x (f32 x,
///                         y, z)
namespace eigencast {

/// The rate of a clip whose source states none.
inline constexpr double kUnstatedRateHz = 30;

/// Where recorded poses come from, in any order; at most a block of them is in memory. Not thread-safe.
struct Frames {
  std::size_t count = 0;
  /// Positions, and faces where the format has any. appearance: filled where the frame states colours; null: unwanted.
  std::function<Result<Surface>(std::size_t frame, Appearance* appearance)> read;
  std::function<std::string(std::size_t frame)> label;  ///< "frame 3 of clip.npy", for messages.
  double rate_hz = kUnstatedRateHz;
};

std::string frame_of_file(std::size_t frame, const std::string& path);

/// Opens a file that ends in pc2 or mdd. MDD states times: the rate is that of their mean distance. Errors: kNotFound,
/// kIo, kCorrupt (its size is not what its header makes it), kTooLarge.
Result<Frames> open_point_cache(const std::string& path);

}  // namespace eigencast
