// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>

#include "common/core/bytes.h"

namespace eigencast::broker::websocket {

/// Follows UTF-8 that comes in pieces and finds the first byte that cannot be part of it: overlong forms, surrogates
/// and what is beyond U+10FFFF are refused (RFC 3629, section 4).
class Utf8Check {
 public:
  /// False: no continuation can make this UTF-8. REQUIRES: no earlier call returned false.
  [[nodiscard]] bool add(ByteView bytes);
  /// Whether the text may end here.
  bool is_whole() const { return left_ == 0; }

 private:
  bool lead(std::uint8_t byte);

  std::uint8_t left_ = 0;  ///< Continuation bytes to come.
  std::uint8_t least_ = 0x80;
  std::uint8_t most_ = 0xbf;  ///< Of the next one.
};

}  // namespace eigencast::broker::websocket
