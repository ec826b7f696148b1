// SPDX-License-Identifier: MIT
#include "broker/websocket/protocol.h"

#include <openssl/sha.h>

#include <algorithm>
#include <array>
#include <utility>

#include "common/core/text.h"

namespace eigencast::broker::websocket {
namespace {

/// `out`: bytes or text.
void append_header_to(Opcode opcode, std::size_t size, auto& out) {
  const auto append = [&](std::uint64_t byte) { out.push_back(static_cast<std::uint8_t>(byte)); };
  append(0x80 | static_cast<std::size_t>(opcode));
  if (size <= kMaxControlBytes) return append(size);
  const int bytes = size <= 0xffff ? 2 : 8;
  append(bytes == 2 ? 126 : 127);
  for (int shift = 8 * (bytes - 1); shift >= 0; shift -= 8) append(std::uint64_t{size} >> shift);
}

/// The first `max` bytes of `text` at most, without a partial character.
std::string_view cut(std::string_view text, std::size_t max) {
  if (text.size() <= max) return text;
  while (max > 0 && (static_cast<unsigned char>(text[max]) & 0xc0) == 0x80) --max;
  return text.substr(0, max);
}

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

bool is_valid_close_code(std::uint16_t code) {
  if (code >= 3000) return code <= 4999;
  return code >= 1000 && code <= 1014 && code != 1004 && code != 1005 && code != 1006;
}

void append_header(Opcode opcode, std::size_t size, Bytes& out) {
  append_header_to(opcode, size, out);
}

std::shared_ptr<const std::string> framed(Opcode opcode, std::string_view payload) {
  std::string message;
  message.reserve(kMaxHeaderBytes + payload.size());
  append_header_to(opcode, payload.size(), message);
  message.append(payload);
  return std::make_shared<const std::string>(std::move(message));
}

std::shared_ptr<const std::string> framed_close(CloseCode code, std::string_view reason) {
  if (code == CloseCode::kNone) return framed(Opcode::kClose, {});
  const auto number = static_cast<std::uint16_t>(code);
  std::string payload{static_cast<char>(number >> 8), static_cast<char>(number & 0xff)};
  payload += cut(reason, kMaxControlBytes - 2);
  return framed(Opcode::kClose, payload);
}

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
