// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "broker/relay/generation.h"
#include "common/core/bytes.h"
#include "common/core/hash/sha256.h"

namespace eigencast::broker {

/// What a stream remembers, as its owner tells the other brokers. A root of 0: nothing.
struct MemoryNotice {
  std::uint32_t epoch = 0, root = 0, number = 0;  ///< The owner's, see Generation.
  std::vector<Sha256> segments{};                 ///< All of them, in order.

  bool goes_on_as(const MemoryNotice& later) const;
  bool operator==(const MemoryNotice&) const = default;
};

/// Messages about a memory, beside a stream's frames (subject_of_memory), little-endian:
///   'M' root u32 number u32 epoch u32 ids[32 n]
///   'F' root u32 number u32, then as Follower's: a frame of the sender that needs so much of it
struct MemoryMessage {
  std::optional<MemoryNotice> notice;  ///< Of 'M'.
  std::uint32_t root = 0, number = 0;  ///< Of 'F', as
  Bytes frame{};
};

/// Its last token is that of no stream's.
inline std::string subject_of_memory(const std::string& frames) {
  return frames + ".=";
}
Bytes bytes_from(const MemoryNotice& notice);
Bytes head_of_recalled(const Generation& memory, std::uint32_t needed, std::uint32_t epoch, std::uint64_t sequence);
/// Nothing: malformed, or over limits::kMaxMemorySegments.
std::optional<MemoryMessage> memory_message_from(ByteView bytes);

}  // namespace eigencast::broker
