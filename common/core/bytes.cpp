// SPDX-License-Identifier: MIT
#include "common/core/bytes.h"

namespace eigencast {

ByteView ByteReader::bytes(std::size_t count) {
  if (failed_ || count > in_.size() - at_) {
    failed_ = true;
    return {};
  }
  const ByteView view = in_.subspan(at_, count);
  at_ += count;
  return view;
}

std::uint64_t ByteReader::little_endian(std::size_t count) {
  std::uint64_t value = 0;
  std::size_t shift = 0;
  for (const std::uint8_t byte : bytes(count)) {
    value |= std::uint64_t{byte} << shift;
    shift += 8;
  }
  return value;
}

std::uint64_t ByteReader::varint() {
  std::uint64_t value = 0;
  for (unsigned shift = 0; shift < 64; shift += 7) {
    const std::uint8_t byte = u8();
    const std::uint64_t low = byte & 0x7fu;
    if (failed_ || (shift == 63 && low > 1)) break;
    value |= low << shift;
    if (byte < 0x80) {
      if (byte == 0 && shift > 0) break;
      return value;
    }
  }
  failed_ = true;
  return 0;
}

}  // namespace eigencast
