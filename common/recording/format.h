// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>

#include "common/core/bytes.h"
#include "common/core/clock.h"

/// The bytes of a recording (docs/recording-format.md), little-endian.
namespace eigencast::recording {

inline constexpr std::array<std::uint8_t, 8> kMagic{'E', 'C', 'R', 'E', 'C', 'O', 'R', '\n'};
inline constexpr std::uint32_t kVersion = 2;
inline constexpr std::size_t kHeaderBytes = 12;
inline constexpr std::size_t kHeadBytes = 17;  ///< Begins a record.
inline constexpr std::size_t kEndBytes = kHeadBytes + 24;
inline constexpr std::size_t kIndexEntryBytes = 24;
inline constexpr std::size_t kMaxBodyBytes = (std::size_t{256} << 20) + 32;  ///< An object is the largest.
inline constexpr std::size_t kIdBytes = 32;

/// Values are in files, from 1 on.
enum class Type : std::uint8_t { kStart = 1, kAnnounce, kFrame, kCheckpoint, kObject, kIndex, kEnd, kGap, kMemory };

/// Where a reader may begin: a checkpoint, and the announcement that it belongs to, as offsets in the file.
struct IndexEntry {
  TimeUs time_us = 0;
  std::uint64_t checkpoint = 0;
  std::uint64_t announce = 0;
};

/// What a recording says of itself in its first record. Texts have at most 255 bytes.
struct Start {
  std::string stream;
  std::string software;
  std::uint64_t started_unix_us = 0;  ///< Wall clock of the recorder.
};

/// CRC-32C (Castagnoli, "Optimization of cyclic redundancy-check codes with 24 and 32 parity bits", 1993) of `data`
/// after that of what precedes it; begin with 0.
std::uint32_t crc32c(std::uint32_t before, ByteView data);

/// The head of a record over `body`, of kHeadBytes.
Bytes head_of(Type type, TimeUs time_us, ByteView body);

}  // namespace eigencast::recording
