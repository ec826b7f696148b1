// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "common/core/result.h"
#include "view/picture.h"

namespace eigencast {

/// Reads a JPEG file from memory, grey ones as RGB. `name` is for messages. Safe on hostile input. Errors: kCorrupt,
/// kTooLarge (kMaxPixels, kMaxSide, 200 scans), kUnsupported (CMYK).
Result<Picture> read_jpeg_bytes(std::span<const std::uint8_t> bytes, const std::string& name);

}  // namespace eigencast
