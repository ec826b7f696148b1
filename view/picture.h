// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "common/core/result.h"

namespace eigencast {

/// Eight bits a channel, row by row from the top.
struct Picture {
  int width = 0, height = 0;
  std::vector<std::uint8_t> rgb;         ///< height x width x 3
  std::vector<std::uint8_t> alpha = {};  ///< height x width, the colours not multiplied by it; empty: opaque.

  const std::uint8_t* pixel(int x, int y) const {
    return rgb.data() +
           3 * (static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x));
  }
};

/// Limits of what is read: 16,384 x 8,192 pixels, 400 MB.
inline constexpr std::size_t kMaxPixels = std::size_t{1} << 27;
inline constexpr int kMaxSide = 16'384;

/// Writes under a temporary name and renames. Errors: kIo, kInvalidArgument.
Result<void> write_png(const std::string& path, const Picture& picture);

/// Drops alpha. `name` is for messages. Errors: kCorrupt, kTooLarge (max_pixels, kMaxSide).
Result<Picture> read_png_bytes(std::span<const std::uint8_t> bytes, const std::string& name,
                               std::size_t max_pixels = kMaxPixels);

/// Grey ones as RGB. Errors: kCorrupt, kTooLarge (max_pixels, kMaxSide, 200 scans), kUnsupported (CMYK).
Result<Picture> read_jpeg_bytes(std::span<const std::uint8_t> bytes, const std::string& name,
                                std::size_t max_pixels = kMaxPixels);

}  // namespace eigencast
