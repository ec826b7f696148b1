// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <string_view>

#include "common/core/result.h"

namespace eigencast {

/// Writes a file so that a reader sees the old or the new content, never a part: under a temporary name in the same folder, then
/// renamed. A device or a pipe is written to as it is. One writer per path at a time. Errors: kIo; nothing is left behind then.
Result<void> write_file_atomically(const std::string& path, std::string_view content);

}  // namespace eigencast
