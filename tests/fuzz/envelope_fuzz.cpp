// SPDX-License-Identifier: MIT
#include <cstdlib>

#include "common/wire/envelope.h"

using namespace eigencast;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto frame = parse_frame(ByteView(data, size));
  if (!frame) return 0;
  Bytes again;
  append_envelope(frame->envelope, again);
  again.insert(again.end(), frame->payload.begin(), frame->payload.end());
  if (again != Bytes(data, data + size)) std::abort();
  return 0;
}
