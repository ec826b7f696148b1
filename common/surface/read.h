// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <string>

#include "common/surface/motion_clip.h"

namespace eigencast {

/// Reads one surface; vertices keep the file's order and number, n-gons are split in fans, nothing is merged or
/// dropped. OBJ, PLY, OFF, STL (through OpenMesh's readers), XYZ (x y z [nx ny nz] a line), NPY ((n,3), or the first
/// frame of (T,n,3)). Errors: kNotFound, kIo, kUnsupported (unknown ending), kCorrupt (what is wrong and where),
/// kTooLarge (over limits).
Result<Surface> read_surface(const std::string& path);

/// Opens a clip: a directory or a glob of single files, sorted naturally (f2 before f10); a .npy of shape (T,n,3) with
/// `faces.npy` (F,3) beside it, or named by `faces_path`, if it is a mesh; or one single file (a clip of one frame).
/// A directory with a `vertices.npy` is that clip; else it holds files of one kind, `faces.npy` apart.
/// The first frame is the rest pose unless `rest_path` names one. Every frame is checked against it when it is read.
/// Where the frames have no faces, those of `rest_path` or `faces_path` (.npy or any mesh) hold for all. Errors: as
/// read_surface; kInvalidArgument when the topology of a frame differs, naming the first such frame and how.
Result<std::unique_ptr<MotionClip>> open_clip(const std::string& path, const std::string& rest_path = {},
                                              const std::string& faces_path = {});

}  // namespace eigencast
