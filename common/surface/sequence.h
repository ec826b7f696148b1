// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "common/core/result.h"

/// Private to common/surface.
namespace eigencast {

/// Frames of a clip that readers let through.
inline constexpr std::size_t kMaxClipFrames = 1'000'000;

/// The files that a path names, in natural order: those of a folder or of a glob, which must be of one kind, or the
/// path itself. A folder with a `vertices.npy` is that file. Errors: kNotFound, kIo, kInvalidArgument, kTooLarge.
Result<std::vector<std::string>> files_of_sequence(const std::string& path);

/// Whether the path names a regular file.
bool is_file(const std::string& path);

/// Whether it does, and one that lies below `folder` when all links are resolved. An empty folder holds nothing.
bool is_file_below(const std::string& folder, const std::string& path);

}  // namespace eigencast
