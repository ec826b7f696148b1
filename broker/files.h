// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <string_view>

#include "common/core/result.h"

namespace eigencast::broker {

/// Writes a small file so that a reader sees the old or the new content, never a part. Errors: kIo.
Result<void> write_file_atomically(const std::string& path, std::string_view content);

}  // namespace eigencast::broker
