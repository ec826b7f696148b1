// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <string>

#include "common/surface/motion_clip.h"

/// FBX, Collada and other formats of assimp, where Eigencast is built with it. Private to common/surface.
namespace eigencast {

bool is_foreign(const std::string& ending);

std::string foreign_endings();  ///< "fbx, dae, ..."; empty where built without assimp.

/// Imported by assimp, which opens only the file itself, turned into glTF in memory, and read as such.
/// Errors: kUnsupported (built without assimp), and those of open_gltf_clip.
Result<std::unique_ptr<MotionClip>> open_foreign_clip(const std::string& path, const ClipOptions& options);

}  // namespace eigencast
