// SPDX-License-Identifier: MIT
#include "common/core/base64.h"

#include <cstddef>
#include <cstdint>

namespace eigencast {
namespace {

constexpr std::string_view kLetters[] = {"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/",
                                         "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_"};

}  // namespace

std::string base64_from_bytes(ByteView bytes, Base64 alphabet) {
  const std::string_view letters = kLetters[static_cast<std::size_t>(alphabet)];
  std::string text;
  text.reserve((bytes.size() + 2) / 3 * 4);
  std::uint32_t bits = 0;
  int count = 0;
  for (const std::uint8_t byte : bytes) {
    bits = bits << 8 | byte;
    for (count += 8; count >= 6;) text += letters[bits >> (count -= 6) & 63];
  }
  if (count > 0) text += letters[bits << (6 - count) & 63];
  while (alphabet == Base64::kStandard && text.size() % 4 != 0) text += '=';
  return text;
}

std::optional<Bytes> bytes_from_base64(std::string_view text, Base64 alphabet) {
  const std::string_view letters = kLetters[static_cast<std::size_t>(alphabet)];
  if (alphabet == Base64::kStandard) {
    if (text.size() % 4 != 0) return std::nullopt;
    for (int i = 0; i < 2 && text.ends_with('='); ++i) text.remove_suffix(1);
  }
  if (text.size() % 4 == 1) return std::nullopt;
  Bytes bytes;
  bytes.reserve(text.size() * 3 / 4);
  std::uint32_t bits = 0;
  int count = 0;
  for (const char letter : text) {
    const auto value = letters.find(letter);
    if (value == std::string_view::npos) return std::nullopt;
    bits = bits << 6 | static_cast<std::uint32_t>(value);
    if ((count += 6) >= 8) bytes.push_back(static_cast<std::uint8_t>(bits >> (count -= 8)));
  }
  if ((bits & ((1U << count) - 1)) != 0) return std::nullopt;
  return bytes;
}

}  // namespace eigencast
