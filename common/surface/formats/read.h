// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <string>

#include "common/core/result.h"
#include "common/surface/appearance.h"
#include "common/surface/surface.h"

namespace eigencast {

enum class FileKind { kMesh, kArray, kPointCache, kGltf, kForeign };
/// By the ending of a file's name; nothing: it cannot be read.
std::optional<FileKind> kind_of_file(const std::string& path);

/// For help texts: the endings that read_surface and open_clip know, "obj, ply, ...".
std::string readable_endings();

/// Vertices keep the file's order and number, n-gons are split in fans, nothing is merged or dropped (but see
/// parse_stl). The first pose of a clip. Errors: kNotFound, kIo, kUnsupported (unknown ending), kCorrupt (what is wrong
/// and where), kTooLarge.
///   appearance  filled with the file's colours and textures; null: unwanted
Result<Surface> read_surface(const std::string& path, Appearance* appearance = nullptr);

}  // namespace eigencast
