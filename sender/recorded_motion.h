// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <string>

#include "common/surface/motion_clip.h"

namespace eigencast {

/// A recording as a clip, in the sender's space and order of vertices: poses at even times, on the curve through the
/// recorded ones (ClipMotion). Its rest pose, colours and texture are the asset's. Coefficients stay in memory, poses
/// are rebuilt as they are asked for.
///   rate_hz  0: as the sender announced it
/// Errors: those of read_recording.
Result<std::unique_ptr<MotionClip>> open_recorded_motion(const std::string& path, const std::string& cache_dir,
                                                         double rate_hz);

}  // namespace eigencast
