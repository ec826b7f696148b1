// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <string>

#include "common/surface/motion_clip.h"
#include "sdk/bake.h"

namespace eigencast {

/// What to stream and how to bake it: the options that all commands share.
struct SourceOptions {
  std::string input;           ///< Name of a built-in shape, or a path, directory or glob.
  std::string rest;            ///< File of the rest pose (default: the first frame).
  std::string faces;           ///< faces.npy of a .npy clip (default: the one beside it).
  std::string animation;       ///< Of a glTF file: name or number (default: the first).
  double sample_rate_hz = 30;  ///< Of formats that state curves instead of poses.
  std::string basis = "augmented";
  int rank = 200;
  double asset_error = 1e-4;  ///< See BakeOptions.
  std::string name;  ///< (default: the built-in's, or the file's or folder's without its path: assets are public)
  std::string cache_dir;
};

/// A clip and the asset baked from its rest pose.
struct Source {
  std::unique_ptr<MotionClip> clip;
  BakeResult baked;
};

/// Opens the input: a path that exists, or a glob, wins over a built-in name. Errors: those of builtin_clip and open_clip.
Result<std::unique_ptr<MotionClip>> open_source(const SourceOptions& options);

/// Opens and bakes, or finds it baked.
Result<Source> bake_source(const SourceOptions& options, const BakeProgress& progress);

}  // namespace eigencast
