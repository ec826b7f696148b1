// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>

namespace eigencast {

/// Signed numbers as unsigned ones, small magnitudes first: 0, -1, 1, -2, ...
inline std::uint64_t zigzag(std::int64_t v) {
  return (static_cast<std::uint64_t>(v) << 1) ^ static_cast<std::uint64_t>(v >> 63);
}
inline std::int64_t unzigzag(std::uint64_t v) {
  return static_cast<std::int64_t>(v >> 1) ^ -static_cast<std::int64_t>(v & 1);
}

}  // namespace eigencast
