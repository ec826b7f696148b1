// SPDX-License-Identifier: MIT
#include "common/core/hash/sha256.h"

namespace eigencast {
namespace {

constexpr std::string_view kDigits = "0123456789abcdef";

}  // namespace

std::string Sha256::hex() const {
  std::string text;
  text.reserve(64);
  for (const std::uint8_t byte : digest) {
    text.push_back(kDigits[byte >> 4]);
    text.push_back(kDigits[byte & 15]);
  }
  return text;
}

std::optional<Sha256> Sha256::from_hex(std::string_view hex) {
  if (hex.size() != 64) return std::nullopt;
  Sha256 result;
  for (std::size_t i = 0; i < 32; ++i) {
    const auto high = kDigits.find(hex[2 * i]);
    const auto low = kDigits.find(hex[2 * i + 1]);
    if (high == std::string_view::npos || low == std::string_view::npos) return std::nullopt;
    result.digest[i] = static_cast<std::uint8_t>(high << 4 | low);
  }
  return result;
}

Sha256 sha256(ByteView data) {
  Sha256Stream stream;
  stream.update(data);
  return stream.finish();
}

Sha256 sha256(std::string_view text) {
  return sha256(ByteView(reinterpret_cast<const std::uint8_t*>(text.data()), text.size()));
}

}  // namespace eigencast
