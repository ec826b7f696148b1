// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "common/core/result.h"
#include "common/surface/formats/frames.h"

/// Vertex caches of content creation programs. Private to common/surface.
///   PC2 (little-endian)   char[12] "POINTCACHE2\0", i32 version 1, i32 points, f32 first frame, f32 frames between two
///                         samples, i32 samples; then samples x points x (f32 x, y, z)
///   MDD (big-endian)      i32 frames, i32 points, f32 time in seconds for each frame; then frames x points x (f32 x,
///                         y, z)
namespace eigencast {

/// Opens a file that ends in pc2 or mdd. MDD states times: the rate is that of their mean distance. Errors: kNotFound,
/// kIo, kCorrupt (its size is not what its header makes it), kTooLarge.
Result<Frames> open_point_cache(const std::string& path);

}  // namespace eigencast
