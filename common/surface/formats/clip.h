// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <string>
#include <string_view>

#include "common/surface/motion_clip.h"

namespace eigencast {

///   folder, glob     single files of one kind, sorted naturally (f2 before f10); with a `vertices.npy`, that clip
///   .npy (T,n,3)     with `faces.npy` (F,3) or a rest mesh of the same name beside it, or named, if it is a mesh
///   .pc2, .mdd       with a rest mesh of the same name, or called `rest`, beside it, or named; else a point cloud
///   .gltf, .glb      one of its animations, sampled; all its surfaces as one
///   a single file    a clip of one frame
/// The first frame is the rest pose where none is named or found; where frames have no faces, its own or those of
/// `faces` (.npy or any mesh) hold. Poses stay on disk. Errors: as read_surface; kInvalidArgument when the topology of
/// a frame differs from the rest pose's, naming the frame and how.
Result<std::unique_ptr<MotionClip>> open_clip(const std::string& path, const ClipOptions& options = {});

/// The order of a sequence's files: runs of digits compare as numbers, f2 before f10. A strict total order.
bool natural_less(std::string_view a, std::string_view b);

}  // namespace eigencast
