// SPDX-License-Identifier: MIT
#pragma once

#include <string>

namespace eigencast {

/// For help texts: "obj, ply, ...".
std::string readable_endings();

/// Whether files of that ending can be frames of a sequence.
bool is_frame_ending(const std::string& ending);

/// Whether files of that ending are read through assimp.
bool is_foreign(const std::string& ending);

/// Whether a file of that ending is a clip, or a mesh, by itself and never a frame of a sequence.
bool is_whole_clip(const std::string& ending);

/// "fbx, dae, ..." where built with assimp, else empty.
std::string foreign_endings();

}  // namespace eigencast
