// SPDX-License-Identifier: MIT
#include <cstdlib>

#include "common/recording/reader.h"

using namespace eigencast;

// Records are given out only as they were written, in order, and the same again after a seek.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  auto reader = recording::Reader::over(Bytes(data, data + size));
  if (!reader) return 0;
  if (reader->info().whole_bytes + reader->info().torn_bytes != size) std::abort();
  std::size_t bytes = 0;
  for (;;) {
    const auto record = reader->next();
    if (!record || !*record) break;
    bytes += (**record).body.size();
    if (bytes > size) std::abort();
  }
  for (const auto& entry : reader->index()) {
    if (!reader->seek(entry.time_us)) continue;
    const auto announce = reader->next();
    if (announce && *announce && (**announce).type != recording::Type::kAnnounce) std::abort();
  }
  if (const auto objects = reader->object_offsets()) {
    for (const std::uint64_t offset : *objects) (void)reader->object_at(offset);
  }
  return 0;
}
