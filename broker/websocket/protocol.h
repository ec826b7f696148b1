// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "common/core/bytes.h"

/// The server's half of RFC 6455 (The WebSocket Protocol, I. Fette, A. Melnikov, 2011) as bytes: no sockets, no clock.
namespace eigencast::broker::websocket {

enum class Opcode : std::uint8_t { kContinuation = 0, kText = 1, kBinary = 2, kClose = 8, kPing = 9, kPong = 10 };

/// Section 7.4.1 and the registry of IANA; docs/protocol.md says which the broker uses when.
enum class CloseCode : std::uint16_t {
  kNormal = 1000,
  kGoingAway = 1001,
  kProtocolError = 1002,
  kUnknownData = 1003,
  kNone = 1005,  ///< Never on the wire: the close frame had no code.
  kBadPayload = 1007,
  kPolicy = 1008,
  kTooBig = 1009,
  kInternal = 1011,
  kServiceRestart = 1012,
  kTryAgainLater = 1013,
  kReplaced = 4409,  ///< Our own: another sender has the stream now; do not come back.
};

/// Whether a peer may send this code.
bool is_valid_close_code(std::uint16_t code);

/// The most bytes that a header of a server's frame takes.
inline constexpr std::size_t kMaxHeaderBytes = 10;
/// The most bytes that a ping, pong or close carries.
inline constexpr std::size_t kMaxControlBytes = 125;

/// Appends the header of a whole, unmasked message of `size` bytes.
void append_header(Opcode opcode, std::size_t size, Bytes& out);

/// A whole message as it leaves: header and payload.
std::string framed(Opcode opcode, std::string_view payload);

/// A close frame as it leaves. kNone: without a code. The reason is cut to what fits, between characters.
std::string framed_close(CloseCode code, std::string_view reason);

}  // namespace eigencast::broker::websocket
