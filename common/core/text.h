// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <array>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/core/bytes.h"

namespace eigencast {

/// The parts of `text` between separators: one more than it has separators.
std::vector<std::string_view> split(std::string_view text, char separator);

/// Formats as printf, to any length.
[[gnu::format(printf, 1, 2)]] std::string formatted(const char* format, ...);

/// Drops the blanks, tabs and line ends around it.
std::string_view trimmed(std::string_view text);

/// Text of a peer, fit for a terminal: control characters, those that turn the direction of writing, and bytes that are
/// not UTF-8, as \u001b. A JSON value stays one.
std::string escaped(std::string_view text);

/// So many hexadecimal digits from the system's source of randomness: a name that nobody else chooses. Thread-safe.
std::string random_id(std::size_t digits = 16);

/// RFC 4648: the standard alphabet with padding, or the URL-safe one without.
enum class Base64 { kStandard, kUrl };
std::string base64_from_bytes(ByteView bytes, Base64 alphabet = Base64::kStandard);
/// Strict: no blanks, exact padding, unused bits 0, so that every value has one spelling. Nothing: not base64.
std::optional<Bytes> bytes_from_base64(std::string_view text, Base64 alphabet = Base64::kStandard);

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
