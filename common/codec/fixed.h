// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>

/// The integer arithmetic that every decoder must reproduce bit by bit (docs/protocol.md, "Integer arithmetic").
/// All of it fits 64 bits; >> of a negative number is the arithmetic shift, that is, rounds towards minus infinity.
namespace eigencast::fixed {

inline constexpr std::int32_t kMaxValue = 1 << 30;

inline bool in_range(std::int64_t value) {
  return value >= -std::int64_t{kMaxValue} && value <= std::int64_t{kMaxValue};
}

/// q at one step of the table as q' at another: q' = round_half_away(q * m * 2^(e - 30)), where from - to = 4 e + f,
/// f in 0..3, and m is 2^(f/4) in units of 2^-30.
class Rescale {
 public:
  Rescale(std::uint8_t from, std::uint8_t to) {
    constexpr std::array<std::int64_t, 4> kFourthRoots = {1073741824, 1276901417, 1518500250, 1805811301};
    const int difference = int{from} - int{to};
    multiplier_ = kFourthRoots[static_cast<unsigned>(difference) & 3u];
    shift_ = 30 - (difference >> 2);
  }

  /// REQUIRES: in_range(q). The caller checks whether the result is.
  std::int64_t operator()(std::int64_t q) const {
    if (shift_ == 30 && multiplier_ == kOne) return q;
    if (q == 0 || shift_ > 61) return 0;
    if (shift_ < 0) return kOutOfRange;
    const std::int64_t product = (q < 0 ? -q : q) * multiplier_;
    const std::int64_t magnitude = shift_ == 0 ? product : (product + (std::int64_t{1} << (shift_ - 1))) >> shift_;
    return q < 0 ? -magnitude : magnitude;
  }

 private:
  static constexpr std::int64_t kOne = 1073741824;
  static constexpr std::int64_t kOutOfRange = std::int64_t{1} << 40;
  std::int64_t multiplier_;
  int shift_;
};

}  // namespace eigencast::fixed
