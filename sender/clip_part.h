// SPDX-License-Identifier: MIT
#pragma once

#include <memory>

#include "common/surface/motion_clip.h"

namespace eigencast {

struct ClipPart {
  double from_s = 0;
  double duration_s = 0;  ///< 0: to the end.
  double rate_hz = 0;     ///< 0: the clip's.
  double level = 1;       ///< Of the vertices: in (0, 1].
};

/// A clip's poses in a range of time, at another rate, or of fewer vertices (PrefixOrder: those that its poses need
/// least go first; textures go with them). Poses between two of the clip's lie on catmull_rom_weights()'s curve.
/// The whole gives the clip back. Errors: kInvalidArgument (the range begins behind the clip), those of the clip and of
/// build_prefix_order.
Result<std::unique_ptr<MotionClip>> part_of(std::unique_ptr<MotionClip> clip, const ClipPart& part);

}  // namespace eigencast
