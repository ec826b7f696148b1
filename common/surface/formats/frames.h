// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <functional>
#include <string>

#include "common/core/result.h"
#include "common/surface/appearance.h"
#include "common/surface/surface.h"

/// Recorded poses, whatever holds them. Private to common/surface.
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

inline std::string frame_of_file(std::size_t frame, const std::string& path) {
  return "frame " + std::to_string(frame) + " of " + path;
}

}  // namespace eigencast
