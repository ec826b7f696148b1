// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>

#include "common/core/bytes.h"

namespace eigencast::broker::websocket {

/// Validates UTF-8 that comes in pieces, up to the first invalid byte: refuses overlong forms, surrogates and values
/// beyond U+10FFFF (RFC 3629, section 4).
class Utf8Check {
 public:
  /// False: the bytes are not UTF-8. REQUIRES: no earlier call returned false.
  [[nodiscard]] bool add(ByteView bytes);
  /// Whether the text may end here.
  bool is_whole() const { return remaining_ == 0; }

 private:
  bool lead(std::uint8_t byte);

  std::uint8_t remaining_ = 0;  ///< Continuation bytes to come.
  std::uint8_t min_ = 0x80;
  std::uint8_t max_ = 0xbf;  ///< Range of the next byte: min_ to max_.
};

}  // namespace eigencast::broker::websocket
