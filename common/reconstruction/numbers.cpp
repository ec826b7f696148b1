// SPDX-License-Identifier: MIT
#include "common/reconstruction/numbers.h"

#include <algorithm>
#include <bit>
#include <cmath>

namespace eigencast {
namespace {

constexpr std::uint32_t kSign = 0x80000000;

/// The finite value with `rank` smaller ones before it, digit by digit from the highest: O(n) whatever the values are.
float value_of_rank(std::span<const float> values, std::size_t rank) {
  std::uint32_t found = 0;
  for (int shift = 24; shift >= 0; shift -= 8) {
    std::array<std::size_t, 256> counts{};
    for (const float value : values) {
      const auto bits = std::bit_cast<std::uint32_t>(value);
      const std::uint32_t ordered = (bits & kSign) != 0 ? ~bits : bits | kSign;
      if (std::isfinite(value) && std::uint64_t{ordered} >> (shift + 8) == found) ++counts[ordered >> shift & 255];
    }
    std::uint32_t digit = 0;
    while (rank >= counts[digit]) rank -= counts[digit++];
    found = found << 8 | digit;
  }
  return std::bit_cast<float>((found & kSign) != 0 ? found ^ kSign : ~found);
}

}  // namespace

void numbers_from_coefficients(const Reconstructor& reconstructor, std::span<const double> D, NumberOf what,
                               std::vector<float>& room, std::span<float> values) {
  room.resize(3 * values.size());
  reconstructor.combine(D, 3, static_cast<std::uint32_t>(D.size() / 3), static_cast<std::uint32_t>(values.size()),
                        room);
  for (std::size_t i = 0; i < values.size(); ++i) {
    const float* v = &room[3 * i];
    values[i] = what == NumberOf::kFirst ? v[0] : std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
  }
}

std::optional<std::array<float, 2>> range_without_outliers(std::span<const float> values) {
  const auto finite = static_cast<std::size_t>(
      std::count_if(values.begin(), values.end(), [](float value) { return std::isfinite(value); }));
  if (finite == 0) return std::nullopt;
  const std::size_t outer = finite / 100;
  return std::array<float, 2>{value_of_rank(values, outer), value_of_rank(values, finite - 1 - outer)};
}

}  // namespace eigencast
