// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/core/bytes.h"
#include "common/core/result.h"

/// The values of one band as a run of bytes (docs/protocol.md, "Payload"): exact runs, which need no key before them,
/// and coarse runs, which are predicted from two keys and give the values to within a spacing of the encoder's choice.
namespace eigencast::band {

/// The values of the two latest keys in a band, at the step of the frame, and those of a memory (see PoseMemory).
struct References {
  std::span<const std::int32_t> c1;  ///< The latest key; empty where it lacks the band.
  std::span<const std::int32_t> c2;  ///< The one before it; empty where it lacks the band: then at rest.
  std::span<const std::int32_t>
      e{};  ///< The memory at the phase of this frame; empty: it is predicted from keys alone.
  std::span<const std::int32_t> e1{};  ///< The memory at the phase of the latest key; empty: that had none.
};

/// The precision of a coarse run.
struct Spacing {
  std::uint8_t half = 0;       ///< m: half the distance between reconstruction levels, in steps; 1..63. 0: exact.
  std::uint32_t channels = 3;  ///< c: values in a row.
};

inline constexpr std::uint8_t kMaxHalfSpacing = 63;
/// Precedes an exact run where runs may be coarse.
inline constexpr std::uint8_t kExactFollows = 0xff;

/// Appends an exact run: the differences from c1, or the values themselves if c1 is empty.
void append_exact(std::span<const std::int32_t> values, std::span<const std::int32_t> c1, Bytes& out);

/// Appends a coarse run and writes its decoded values. Chooses levels by a trellis search of rate and distortion: the
/// root mean square error is about 0.56 m, single errors stay below 3 m.
///   values   the targets, `channels` to a row
///   decoded  as many as values; separate memory
/// Returns false, and appends nothing, if a decoded value would leave the range. REQUIRES: from.c1 is not empty.
bool append_coarse(std::span<const std::int32_t> values, const References& from, const Spacing& spacing, Bytes& out,
                   std::span<std::int32_t> decoded);

/// Estimates the bits of a coarse run, up to a constant of the band, from the best prediction. REQUIRES: as above.
double estimated_bits(std::span<const std::int32_t> values, const References& from, const Spacing& spacing);

/// Appends a coarse run whose decoded values are within `half` of their targets, for values that no later key is
/// predicted from. Receivers have `from`, as many values, as both of their keys.
/// Returns false, and appends nothing, if a decoded value might leave the range.
bool append_nearest(std::span<const std::int32_t> values, std::span<const std::int32_t> from, const Spacing& spacing,
                    Bytes& out);

/// Reads the run at the front of `in` (a coarse run takes all of `in`) and returns its bytes. Safe on hostile input.
/// Errors: kCorrupt (a missing reference, missing or extra bytes, a value out of range).
Result<std::size_t> read(ByteView in, const References& from, const Spacing& spacing, std::span<std::int32_t> values);

/// read() selects between the two: all runs are exact where the spacing is 0.
Result<std::size_t> read_exact(ByteView in, std::span<const std::int32_t> c1, std::span<std::int32_t> values);
Result<std::size_t> read_coarse(ByteView in, const References& from, const Spacing& spacing,
                                std::span<std::int32_t> values);

}  // namespace eigencast::band
