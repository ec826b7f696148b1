// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>

#include "common/core/bands.h"
#include "common/core/bytes.h"
#include "common/core/clock.h"
#include "common/core/result.h"

namespace eigencast {

/// What a binary message carries (docs/protocol.md).
enum class FrameKind : std::uint8_t {
  kKey = 1,   ///< One key, predicted from the two keys before it.
  kJoin = 2,  ///< Both keys of the chain's state; needs nothing before it. Its sequence and time are the newer key's.
  kSynthetic = 3,  ///< An interpolated pose in full, predicted from the two latest keys; never a reference.
  kStep = 4,       ///< Compact interpolation: no payload; the pose at `step` between key sequence-1 and key sequence.
  /// A pose beyond key `sequence`, step.at / step.of key intervals ahead: in full, predicted from the two latest keys,
  /// or with no bands and no payload, for the receiver to make. Never a reference.
  kEstimate = 5,
};

/// The position of a pose between two keys: `at` of `of` equal steps from key sequence-1 to key sequence.
/// {0, 0} on keys and joins, which are not interpolated; on estimates the way goes on from key sequence, and `at` may
/// exceed `of`. One byte on the wire: at in the high four bits, of in the low.
struct InterpolationStep {
  std::uint8_t at = 0;  ///< 1..of; 1..15 on estimates
  std::uint8_t of = 0;  ///< 0 (no interpolation) or 1..15
  std::uint8_t byte() const { return static_cast<std::uint8_t>(at << 4 | (of & 15)); }
  bool operator==(const InterpolationStep&) const = default;
};

/// The fixed head of each frame: 27 bytes, little-endian (docs/protocol.md, "Envelope").
///
///   0 kind and flags u8 (kind | flags << 3) | 1 bands u8 | 2 step u8 (at << 4 | of) | 3 stream_id u32 | 7 epoch u32 |
///   11 sequence u64 | 19 capture_us u64
struct Envelope {
  static constexpr std::size_t kBytes = 27;
  /// Flag of a key or join of compact interpolation: not to be shown when it comes, kStep frames lead up to it.
  static constexpr std::uint8_t kAhead = 1;

  FrameKind kind = FrameKind::kKey;
  std::uint8_t flags = 0;       ///< Bits 0 to 4: kAhead; the others are reserved: written 0, rejected otherwise.
  BandMask bands;               ///< Those in the payload. None on kStep, maybe none on kEstimate.
  InterpolationStep step;       ///< Set unless kKey or kJoin.
  std::uint32_t stream_id = 0;  ///< Given by the broker.
  std::uint32_t epoch = 0;      ///< Given by the broker; names the asset.
  std::uint64_t sequence = 0;   ///< Numbers the key that this frame is, or leads up to. Consecutive keys differ by one.
  TimeUs capture_us = 0;        ///< When the pose holds, microseconds on the sender's clock; interpolated for steps.

  bool operator==(const Envelope&) const = default;
};

struct FrameView {
  Envelope envelope;
  ByteView payload;  ///< Points into the bytes parsed.
};

/// Writes the envelope's 27 bytes at the end of `out`. REQUIRES: what parse_frame checks.
void append_envelope(const Envelope& envelope, Bytes& out);

/// Safe on hostile input.
/// Errors: kCorrupt (short, unknown kind, reserved bits set, step out of range, bands or payload missing or
/// superfluous, capture time over limits::kMaxTimeUs), kTooLarge (over limits::kMaxFrameBytes).
Result<FrameView> parse_frame(ByteView message);

}  // namespace eigencast
