// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <string>

#include "common/surface/motion_clip.h"

namespace eigencast {

/// Fraction in [0, 1]; returns false to stop.
using WriteProgress = std::function<bool(double fraction)>;

/// Frame by frame, so that open_clip() gives it back, where it reads the format:
///   x.pc2, x.mdd, x.npy       poses as 32-bit floats, and the rest pose with its faces as x.obj beside them
///   x.obj, x.ply, x.off       a file for each pose: x_000000.obj, ...; coordinates exact
///   x.usda                    see write_usd; not read
///   a folder (ends in '/')    frame_000000.obj, ... in it
/// A cache gets its name when it is whole. Errors: kUnsupported (ending; .glb is write_morphed's), kIo, kCancelled, and
/// those of the clip.
Result<void> write_clip(const MotionClip& clip, const std::string& path, const WriteProgress& progress = {});

/// Whether it could be written, as far as that is known before. Errors: kUnsupported (ending), kIo.
Result<void> check_clip_path(const std::string& path);
Result<void> check_surface_path(const std::string& path);

/// OBJ, PLY (binary, 64-bit floats) or OFF by its ending; coordinates exact. Errors: kUnsupported, kIo.
Result<void> write_surface(const Surface& surface, const std::string& path);

}  // namespace eigencast
