// SPDX-License-Identifier: MIT
#include "tests/fuzz/clip_bytes.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static eigencast::MemoryFile file("mdd");
  eigencast::check_clip(eigencast::open_clip(file.holding(data, size)));
  return 0;
}
