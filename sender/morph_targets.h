// SPDX-License-Identifier: MIT
#pragma once

#include <functional>

#include "common/surface/formats/morph.h"

namespace eigencast {

struct MorphTargets {
  MorphedMotion motion;
  double rms_error = 0;      ///< Of all vertices in all poses, over the diagonal of the rest box.
  double largest_error = 0;  ///< Of any vertex in any pose, likewise.
};

/// The principal components of what a clip's poses add to its rest pose (Alexa, Mueller 2000, "Representing animations
/// by principal components"), and their weights in each pose. At most 512, and 512 MiB.
///   targets  how many; 0: the fewest that move no vertex by more than 1e-4 of the diagonal, or as many as there are
/// Holds some 2 GiB at most; reads the clip a few times. progress: a fraction of it; returns false to stop.
/// Errors: those of the clip; kCancelled.
Result<MorphTargets> morph_targets_of(const MotionClip& clip, std::size_t targets,
                                      const std::function<bool(double fraction)>& progress);

}  // namespace eigencast
