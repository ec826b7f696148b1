// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "common/core/result.h"
#include "common/surface/motion_clip.h"

namespace eigencast {

/// Motion as a sum of displacements of one surface: pose t is base + sum_k weights(t, k) offsets(k). Weights are in
/// [0, 1]: Blender and game engines clamp others.
struct MorphedMotion {
  std::vector<float> base;     ///< n x 3
  std::vector<float> offsets;  ///< targets x n x 3
  std::vector<float> weights;  ///< frames x targets
  std::size_t targets = 0;     ///< At least one.
  std::size_t frames = 0;      ///< At least one.
};

/// Writes glTF 2.0 as one file (.glb): the base with the clip's faces, colours and texture, the offsets as its morph
/// targets, the weights as an animation that is linear between frames. Without normals, which the reader makes of
/// faces. Errors: kIo, kTooLarge (2 GiB). REQUIRES: the motion is of the clip's vertices, and finite.
Result<void> write_morphed(const MotionClip& clip, const MorphedMotion& motion, const std::string& path);

}  // namespace eigencast
