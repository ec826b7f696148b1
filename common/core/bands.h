// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <utility>

namespace eigencast {

/// A set of a stream's bands, of which there are at most eight: bit b is band b, as on the wire.
struct BandMask {
  std::uint8_t bits = 0;

  constexpr BandMask() = default;
  constexpr BandMask(std::uint8_t mask) : bits(mask) {}
  /// The `count` lowest bands; all eight if there are more.
  static constexpr BandMask lowest(std::size_t count) {
    return static_cast<std::uint8_t>((1u << std::min<std::size_t>(count, 8)) - 1);
  }

  constexpr bool empty() const { return bits == 0; }
  constexpr bool has(std::size_t band) const { return (bits >> band & 1) != 0; }
  constexpr bool includes(BandMask other) const { return (other.bits & ~bits) == 0; }

  friend constexpr BandMask operator&(BandMask a, BandMask b) { return static_cast<std::uint8_t>(a.bits & b.bits); }
  friend constexpr BandMask operator|(BandMask a, BandMask b) { return static_cast<std::uint8_t>(a.bits | b.bits); }
  /// The bands that one of the two has and the other lacks.
  friend constexpr BandMask operator^(BandMask a, BandMask b) { return static_cast<std::uint8_t>(a.bits ^ b.bits); }
  BandMask& operator&=(BandMask other) { return *this = *this & other; }
  BandMask& operator|=(BandMask other) { return *this = *this | other; }
  friend constexpr bool operator==(BandMask, BandMask) = default;
};

/// The rows [first, end) of a band; `ends` holds the row at which each band ends.
inline std::pair<std::uint32_t, std::uint32_t> band_range(std::span<const std::uint32_t> ends, std::size_t band) {
  return {band == 0 ? 0 : ends[band - 1], ends[band]};
}
/// The values [first, end) of a band in a row-major matrix of `channels` columns.
inline std::pair<std::size_t, std::size_t> band_range(std::span<const std::uint32_t> ends, std::size_t band,
                                                      std::size_t channels) {
  const auto [first, end] = band_range(ends, band);
  return {first * channels, end * channels};
}

}  // namespace eigencast
