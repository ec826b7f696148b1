// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>

#include "common/core/bytes.h"

namespace eigencast::broker::websocket {

/// Validates UTF-8 that comes in pieces, up to the first invalid byte (RFC 3629, section 4).
class Utf8Check {
 public:
  /// REQUIRES: no earlier call returned false.
  [[nodiscard]] bool add(ByteView bytes);
  bool is_whole() const { return remaining_ == 0; }

 private:
  bool lead(std::uint8_t byte);

  std::uint8_t remaining_ = 0;  ///< Continuation bytes to come.
  std::uint8_t min_ = 0x80;
  std::uint8_t max_ = 0xbf;  ///< Range of the next byte: min_ to max_.
};

}  // namespace eigencast::broker::websocket
