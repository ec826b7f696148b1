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

/// The same of differences modulo 2^16.
inline std::uint16_t zigzag16(std::uint16_t difference) {
  return static_cast<std::uint16_t>((difference << 1) ^ (difference & 0x8000u ? 0xffffu : 0u));
}
inline std::uint16_t unzigzag16(std::uint16_t code) {
  return static_cast<std::uint16_t>((code >> 1) ^ (code & 1u ? 0xffffu : 0u));
}

}  // namespace eigencast
