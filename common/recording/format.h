// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>

#include "common/core/bytes.h"
#include "common/core/clock.h"

/// A recording (docs/recording-format.md), little-endian:
///
///   file       = "ECRECOR\n" | version u32 = 1 | record*
///   record     = length u32 | type u8 | time_us u64 | crc u32 | `length` bytes of body
///   crc        = CRC-32C of length, type, time_us and body
///   start      = started_unix_us u64 | stream (u8 length, text) | software (u8 length, text)        the first record
///   announce   = the text of the control message
///   frame      = a binary message of the sender
///   checkpoint = a join frame: the state after the last frame before it
///   object     = id (32 bytes) | an object of the asset
///   index      = offset of the index before it u64, 0 if none | (time_us, checkpoint, announce) u64 each, 1 or more
///   end        = offset of the last index u64 | frames u64 | lost u64                               the last record
///   gap        = frames lost u64
namespace eigencast::recording {

inline constexpr std::array<std::uint8_t, 8> kMagic{'E', 'C', 'R', 'E', 'C', 'O', 'R', '\n'};
inline constexpr std::uint32_t kVersion = 1;
inline constexpr std::size_t kHeaderBytes = 12;
inline constexpr std::size_t kHeadBytes = 17;  ///< Of a record.
inline constexpr std::size_t kEndBytes = kHeadBytes + 24;
inline constexpr std::size_t kIndexEntryBytes = 24;
inline constexpr std::size_t kMaxBodyBytes = (std::size_t{256} << 20) + 32;  ///< An object is the largest.
inline constexpr std::size_t kIdBytes = 32;

enum class Type : std::uint8_t {
  kStart = 1,
  kAnnounce = 2,
  kFrame = 3,
  kCheckpoint = 4,
  kObject = 5,
  kIndex = 6,
  kEnd = 7,
  kGap = 8,
};

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
/// after that of what stands before it; begin with 0.
std::uint32_t crc32c(std::uint32_t before, ByteView data);

/// The head of a record over `body`, of kHeadBytes.
Bytes head_of(Type type, TimeUs time_us, ByteView body);

}  // namespace eigencast::recording
