// SPDX-License-Identifier: MIT
#include "common/core/text.h"

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cstdarg>
#include <cstdio>
#include <random>

namespace eigencast {
namespace {

constexpr std::string_view kLetters[] = {"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/",
                                         "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_"};

}  // namespace

std::vector<std::string_view> split(std::string_view text, char separator) {
  std::vector<std::string_view> parts;
  for (std::size_t at = 0; at <= text.size(); at += parts.back().size() + 1) {
    parts.push_back(text.substr(at, text.find(separator, at) - at));
  }
  return parts;
}

std::string formatted(const char* format, ...) {
  va_list values, again;
  va_start(values, format);
  va_copy(again, values);
  std::string text(static_cast<std::size_t>(std::max(0, std::vsnprintf(nullptr, 0, format, values))), '\0');
  std::vsnprintf(text.data(), text.size() + 1, format, again);
  va_end(again);
  va_end(values);
  return text;
}

std::string_view trimmed(std::string_view text) {
  constexpr std::string_view kBlanks = " \t\v\f\r\n";
  const std::size_t first = text.find_first_not_of(kBlanks);
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(kBlanks) - first + 1);
}

std::string escaped(std::string_view text) {
  std::string out;
  while (!text.empty()) {
    const auto lead = static_cast<unsigned char>(text.front());
    const int ones = std::countl_one(lead);
    const std::size_t wanted = ones >= 2 && ones <= 4 ? static_cast<std::size_t>(ones) : 1;
    std::size_t length = 1;
    std::uint32_t code = lead & (wanted == 1 ? 0xFFU : 0x7FU >> wanted);
    for (; length < std::min(wanted, text.size()) && (text[length] & 0xC0) == 0x80; ++length)
      code = code << 6 | (static_cast<unsigned char>(text[length]) & 0x3FU);
    if (length < wanted) length = 1, code = lead;
    const bool turns = (code >= 0x2028 && code <= 0x202E) || (code >= 0x2066 && code <= 0x2069);
    const bool plain = (code >= 0x20 && code < 0x7F) || (code >= 0xA0 && length > 1 && !turns);
    if (plain) {
      out += text.substr(0, length);
    } else {
      std::array<char, 8> hex{};
      const std::string_view digits(hex.data(), std::to_chars(hex.data(), hex.data() + hex.size(), code, 16).ptr);
      (out += "\\u").append(digits.size() < 4 ? 4 - digits.size() : 0, '0') += digits;
    }
    text.remove_prefix(length);
  }
  return out;
}

std::string random_id(std::size_t digits) {
  std::random_device device;
  std::string id;
  while (id.size() < digits) id += "0123456789abcdef"[device() & 15];
  return id;
}

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
