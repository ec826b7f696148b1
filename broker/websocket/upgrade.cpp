// SPDX-License-Identifier: MIT
#include "broker/websocket/upgrade.h"

#include <openssl/sha.h>

#include <algorithm>
#include <array>

#include "common/core/text.h"

namespace eigencast::broker::websocket {
namespace {

constexpr std::size_t kKeyLetters = 24;  // 16 bytes; the last two letters are padding.

bool is_base64(char c) {
  return (c >= 'A' && c <= 'Z') || (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '+' || c == '/';
}

std::string accept_of(std::string_view key) {
  const std::string text = std::string(key) + "258EAFA5-E914-47DA-95CA-C5AB0DC85B11";
  std::array<unsigned char, SHA_DIGEST_LENGTH> hash;
  SHA1(reinterpret_cast<const unsigned char*>(text.data()), text.size(), hash.data());
  return base64_from_bytes(hash);
}

}  // namespace

bool is_key(std::string_view key) {
  return key.size() == kKeyLetters && key.ends_with("==") &&
         std::all_of(key.begin(), key.end() - 2, [](char c) { return is_base64(c); });
}

std::string upgrade_answer(std::string_view key, std::string_view subprotocol, std::string_view server) {
  std::string answer =
      "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: ";
  answer += accept_of(key);
  if (!subprotocol.empty()) answer.append("\r\nSec-WebSocket-Protocol: ").append(subprotocol);
  return answer.append("\r\nServer: ").append(server).append("\r\n\r\n");
}

}  // namespace eigencast::broker::websocket
