// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <cstring>

namespace eigencast {

static_assert(std::endian::native == std::endian::little, "values are copied from the file as they are");

/// The T whose bytes start at `bytes`, which need not be aligned.
template <typename T, bool big_endian = false>
T scalar_at(const char* bytes) {
  std::array<char, sizeof(T)> copy;
  std::memcpy(copy.data(), bytes, sizeof(T));
  if (big_endian) std::reverse(copy.begin(), copy.end());
  return std::bit_cast<T>(copy);
}

/// The value of IEEE 754 binary16 bits.
double double_from_half(std::uint16_t bits);

}  // namespace eigencast
