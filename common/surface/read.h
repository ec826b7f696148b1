// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <string>

#include "common/surface/appearance.h"
#include "common/surface/motion_clip.h"

namespace eigencast {

/// Reads one surface; vertices keep the file's order and number, n-gons are split in fans, nothing is merged or
/// dropped. OBJ, PLY, OFF, STL (through OpenMesh's readers), XYZ (x y z [nx ny nz] a line), NPY ((n,3), or the first
/// frame of (T,n,3)), PC2 and MDD (first frame, no faces), glTF (see open_clip). Errors: kNotFound, kIo, kUnsupported
/// (unknown ending), kCorrupt (what is wrong and where), kTooLarge (over limits). looks: filled with what the file says
/// of colours and textures, if wanted.
Result<Surface> read_surface(const std::string& path, Appearance* looks = nullptr);

struct ClipOptions {
  std::string rest{};       ///< File of the rest pose (default: beside a cache; else the first frame).
  std::string faces{};      ///< Faces of a .npy clip (default: faces.npy beside it).
  std::string animation{};  ///< Name or number of one of a glTF file's animations (default: the first).
  double rate_hz = 30;      ///< Poses a second of formats that state curves instead of poses.
};

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

/// For help texts: the endings that read_surface and open_clip know, "obj, ply, ...".
std::string readable_endings();

}  // namespace eigencast
