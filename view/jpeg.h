// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "common/core/result.h"
#include "view/picture.h"

namespace eigencast {

/// Reads a JPEG file from memory, grey ones as colours; `name` is for the error's words. Safe on hostile input. Errors:
/// kCorrupt, kTooLarge (kMaxPixels, or scans without end), kUnsupported (colours of print).
Result<Picture> read_jpeg_bytes(std::span<const std::uint8_t> bytes, const std::string& name);

}  // namespace eigencast
