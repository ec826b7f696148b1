// SPDX-License-Identifier: MIT
#include "common/recording/format.h"

namespace eigencast::recording {
namespace {

constexpr std::array<std::uint32_t, 256> make_table() {
  std::array<std::uint32_t, 256> table{};
  for (std::uint32_t i = 0; i < 256; ++i) {
    std::uint32_t value = i;
    for (int bit = 0; bit < 8; ++bit) value = value & 1 ? value >> 1 ^ 0x82f63b78u : value >> 1;
    table[i] = value;
  }
  return table;
}

constexpr auto kTable = make_table();

}  // namespace

std::uint32_t crc32c(std::uint32_t before, ByteView data) {
  std::uint32_t crc = ~before;
  for (const std::uint8_t byte : data) crc = kTable[(crc ^ byte) & 0xff] ^ crc >> 8;
  return ~crc;
}

Bytes head_of(Type type, TimeUs time_us, ByteView body) {
  Bytes head;
  ByteWriter out(head);
  out.u32(static_cast<std::uint32_t>(body.size()));
  out.u8(static_cast<std::uint8_t>(type));
  out.u64(static_cast<std::uint64_t>(time_us));
  out.u32(crc32c(crc32c(0, head), body));
  return head;
}

}  // namespace eigencast::recording
