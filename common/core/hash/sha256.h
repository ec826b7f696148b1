// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <compare>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "common/core/bytes.h"

namespace eigencast {

/// A SHA-256 digest; the content id of assets and chunks.
struct Sha256 {
  std::array<std::uint8_t, 32> digest{};

  /// 64 lower-case hexadecimal digits.
  std::string hex() const;
  /// The other way round; nothing for any other text.
  static std::optional<Sha256> from_hex(std::string_view hex);

  auto operator<=>(const Sha256&) const = default;
};

Sha256 sha256(ByteView data);
Sha256 sha256(std::string_view text);

/// Digests data that comes in parts. Not thread-safe.
class Sha256Stream {
 public:
  Sha256Stream();
  void update(ByteView data);
  /// The digest of all so far. REQUIRES: called once, nothing after it.
  Sha256 finish();

 private:
  std::unique_ptr<void, void (*)(void*)> context_;
};

}  // namespace eigencast
