// SPDX-License-Identifier: MIT
#include <algorithm>
#include <cstdlib>

#include "sender/pose_stream.h"

using namespace eigencast;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  PoseStream stream(4);
  PipePace pace(0);
  const std::size_t piece = 1 + *data;
  TimeUs last_us = -1;
  for (std::size_t at = 1; at < size;) {
    const auto room = stream.room();
    const std::size_t count = std::min({room.size(), piece, size - at});
    if (count == 0) std::abort();
    std::copy_n(reinterpret_cast<const char*>(data + at), count, room.begin());
    at += count;
    const auto whole = stream.filled(count);
    if (!whole) return 0;
    if (!*whole) continue;
    const auto due_us = pace.due_us(static_cast<TimeUs>(at), stream.time_s());
    if (!due_us) return 0;
    if (*due_us <= last_us) std::abort();
    last_us = *due_us;
  }
  return 0;
}
