// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <string_view>

#include "common/core/result.h"

namespace eigencast {

/// Writes a file so that a reader sees the old or the new content, never a part: under a temporary name in the same
/// folder, then renamed. A device, a pipe or a link (/dev/stdout is one) is written to as it is. One writer per path at
/// a time. Errors: kIo; nothing is left behind then.
Result<void> write_file_atomically(const std::string& path, std::string_view content);

/// Whether a file could be written there, as far as can be told without doing it. Empty: nothing is meant. Errors: kIo.
Result<void> check_place_of_file(const std::string& path);
/// Whether files could be written into a folder, which may have to be made. Errors: kIo.
Result<void> check_place_of_folder(const std::string& path);

}  // namespace eigencast
