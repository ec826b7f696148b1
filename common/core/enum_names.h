// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <optional>
#include <string_view>

namespace eigencast {

/// The names of an enumeration's values, in their order from 0 on.
template <typename Enum, std::size_t N>
struct EnumNames {
  std::array<std::string_view, N> names;

  constexpr std::string_view operator[](Enum value) const {
    return static_cast<std::size_t>(value) < N ? names[static_cast<std::size_t>(value)] : "unknown";
  }
  constexpr std::optional<Enum> find(std::string_view name) const {
    const auto at = std::find(names.begin(), names.end(), name);
    if (at == names.end()) return std::nullopt;
    return static_cast<Enum>(at - names.begin());
  }
};

/// The value after this one, of `count`; the first after the last.
template <typename Enum>
constexpr Enum next_of(Enum value, int count) {
  return static_cast<Enum>((static_cast<int>(value) + 1) % count);
}

}  // namespace eigencast
