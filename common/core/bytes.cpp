// SPDX-License-Identifier: MIT
#include "common/core/bytes.h"

namespace eigencast {

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
