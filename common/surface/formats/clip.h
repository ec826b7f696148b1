// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <string>

#include "common/surface/formats/clip_options.h"
#include "common/surface/motion_clip.h"

namespace eigencast {

/// Opens a clip:
///   folder, glob     single files of one kind, sorted naturally (f2 before f10); with a `vertices.npy`, that clip
///   .npy (T,n,3)     with `faces.npy` (F,3) or a rest mesh of the same name beside it, or named, if it is a mesh
///   .pc2, .mdd       with a rest mesh of the same name, or called `rest`, beside it, or named; else a point cloud
///   .gltf, .glb      one of its animations, sampled; all its surfaces as one
///   a single file    a clip of one frame
/// The first frame is the rest pose where none is named or found. Every frame is checked against it when it is read.
/// Where the frames have no faces, those of the rest pose or of `faces` (.npy or any mesh) hold for all. Poses stay on
/// disk: memory does not grow with the number of frames. Errors: as read_surface; kInvalidArgument when the topology of
/// a frame differs, naming the first such frame and how.
Result<std::unique_ptr<MotionClip>> open_clip(const std::string& path, const ClipOptions& options = {});

}  // namespace eigencast
