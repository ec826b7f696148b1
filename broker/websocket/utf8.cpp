// SPDX-License-Identifier: MIT
#include "broker/websocket/utf8.h"

#include <cstring>

namespace eigencast::broker::websocket {
namespace {

std::size_t ascii_run(ByteView bytes) {
  std::size_t at = 0;
  for (std::uint64_t word = 0; at + sizeof word <= bytes.size(); at += sizeof word) {
    std::memcpy(&word, bytes.data() + at, sizeof word);
    if ((word & 0x8080808080808080u) != 0) break;
  }
  return at;
}

}  // namespace

bool Utf8Check::add(ByteView bytes) {
  std::size_t at = 0;
  while (at < bytes.size()) {
    if (remaining_ == 0) {
      at += ascii_run(bytes.subspan(at));
      if (at == bytes.size()) return true;
      if (!lead(bytes[at++])) return false;
      continue;
    }
    const std::uint8_t byte = bytes[at++];
    if (byte < min_ || byte > max_) return false;
    min_ = 0x80;
    max_ = 0xbf;
    --remaining_;
  }
  return true;
}

bool Utf8Check::lead(std::uint8_t byte) {
  if (byte < 0x80) return true;
  if (byte < 0xc2 || byte > 0xf4) return false;
  remaining_ = byte < 0xe0 ? 1 : byte < 0xf0 ? 2 : 3;
  if (byte == 0xe0) min_ = 0xa0;
  if (byte == 0xed) max_ = 0x9f;
  if (byte == 0xf0) min_ = 0x90;
  if (byte == 0xf4) max_ = 0x8f;
  return true;
}

}  // namespace eigencast::broker::websocket
