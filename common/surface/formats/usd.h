// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <string>

#include "common/surface/motion_clip.h"

/// Private to common/surface.
namespace eigencast {

/// A layer of Universal Scene Description as text (.usda): one Mesh or Points whose points are sampled in time, as
/// 32-bit floats; colours of vertices; y up. Written pose by pose. Errors: kIo, kCancelled, those of the clip.
Result<void> write_usd(const MotionClip& clip, const std::string& path,
                       const std::function<bool(double fraction)>& progress);

}  // namespace eigencast
