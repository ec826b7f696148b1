// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <string_view>

namespace eigencast::broker::websocket {

/// Whether `key` is a valid Sec-WebSocket-Key: 16 bytes in base64 (RFC 6455, 4.1).
bool is_key(std::string_view key);

/// The response head that accepts an upgrade (RFC 6455, 4.2.2). `subprotocol` empty: none was requested.
/// REQUIRES: is_key(key); the other two hold no line ends.
std::string upgrade_answer(std::string_view key, std::string_view subprotocol, std::string_view server);

}  // namespace eigencast::broker::websocket
