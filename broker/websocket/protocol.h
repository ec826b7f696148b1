// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <memory>
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
  kNone = 1005,  ///< Never sent: the close frame has no code.
  kBadPayload = 1007,
  kPolicy = 1008,
  kTooBig = 1009,
  kInternal = 1011,
  kServiceRestart = 1012,
  kTryAgainLater = 1013,
  kReplaced = 4409,  ///< Private: another sender has taken the stream; do not reconnect.
};

bool is_valid_close_code(std::uint16_t code);

inline constexpr std::size_t kMaxHeaderBytes = 10;    ///< A server's frame has no more.
inline constexpr std::size_t kMaxControlBytes = 125;  ///< Payload of ping, pong and close.

void append_header(Opcode opcode, std::size_t size, Bytes& out);

/// For all that get it.
std::shared_ptr<const std::string> framed(Opcode opcode, std::string_view payload);

/// A close frame. kNone: without a code. Truncates the reason between characters.
std::shared_ptr<const std::string> framed_close(CloseCode code, std::string_view reason);

/// Whether `key` is a valid Sec-WebSocket-Key: 16 bytes in base64 (RFC 6455, 4.1).
bool is_key(std::string_view key);

/// The response head that accepts an upgrade (RFC 6455, 4.2.2). `subprotocol` empty: none was requested.
/// REQUIRES: is_key(key); the other two hold no line ends.
std::string upgrade_answer(std::string_view key, std::string_view subprotocol, std::string_view server);

}  // namespace eigencast::broker::websocket
