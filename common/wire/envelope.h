// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>

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

/// What is known of a frame besides its payload. On the wire it takes 5 to 9 bytes, of joins up to 22: the rest follows
/// from the receiver's newest key (ChainClock).
struct Envelope {
  static constexpr std::size_t kMaxBytes = 36;
  static constexpr std::size_t kKeyBytes = 6;  ///< Of a key of an even stream whose id is below 128.
  /// Flag of a key or join of compact interpolation: not to be shown when it comes, kStep frames lead up to it.
  static constexpr std::uint8_t kAhead = 1;

  FrameKind kind = FrameKind::kKey;
  std::uint8_t flags = 0;       ///< kAhead or 0.
  BandMask bands;               ///< Those in the payload. None on kStep, maybe none on kEstimate.
  InterpolationStep step;       ///< Set unless kKey or kJoin.
  std::uint32_t stream_id = 0;  ///< Given by the broker.
  std::uint32_t epoch = 0;      ///< Given by the broker; names the asset.
  std::uint64_t sequence = 0;   ///< Numbers the key that this frame is, or leads up to. Consecutive keys differ by one.
  TimeUs capture_us = 0;        ///< When the pose holds, microseconds on the sender's clock; interpolated for steps.
  std::uint8_t tag = 0;         ///< Stands for the epoch on the wire.
  TimeUs age_us = 0;            ///< Joins: capture time of the newer key minus that of the older.

  bool is_key() const { return kind == FrameKind::kKey || kind == FrameKind::kJoin; }
  bool operator==(const Envelope&) const = default;
};

struct FrameView {
  Envelope envelope;
  ByteView payload;  ///< Points into the bytes parsed.
};

/// A receiver's newest key, from which the envelopes of later frames follow.
struct ChainClock {
  std::uint64_t sequence = 0;
  TimeUs capture_us = 0;
  TimeUs age_us = 0;  ///< Since the key before it; 0: there was none.

  /// The clock once `key`, a key or join that follows, has come.
  static ChainClock after(const Envelope& key, const ChainClock* before);
  bool operator==(const ChainClock&) const = default;
};

/// at / of of a time, rounded down; exact for all times within limits::kMaxTimeUs. REQUIRES: of > 0.
constexpr TimeUs part_of(TimeUs span_us, InterpolationStep step) {
  return span_us / step.of * step.at + span_us % step.of * step.at / step.of;
}

/// Writes an envelope at the end of `out`. `newest`: of the receivers, before the frame; may be null for joins, steps
/// and estimates. REQUIRES: what resolved() checks.
void append_envelope(const Envelope& envelope, const ChainClock* newest, Bytes& out);

/// A frame as it came: what it says itself.
struct WireFrame {
  Envelope envelope;       ///< Sequence and times of joins alone; no epoch.
  std::uint8_t check = 0;  ///< Low byte of the sequence; not of joins.
  TimeUs delay_us = 0;     ///< Keys, synthetic: capture time beyond the expected one.
  ByteView payload;        ///< Points into the bytes parsed.
};

/// Safe on hostile input.
/// Errors: kCorrupt (short, unknown kind, reserved bits set, step out of range, bands or payload missing or
/// superfluous, times over limits::kMaxTimeUs), kTooLarge (over limits::kMaxFrameBytes).
Result<WireFrame> parse_frame(ByteView message);

/// The frame in full; nothing: it does not follow the newest key (null: there is none), or its time is out of range.
/// Ignores id and tag.
std::optional<FrameView> resolved(const WireFrame& frame, const ChainClock* newest, std::uint32_t epoch);

/// A receiver's side of one stream: resolves frames one after the other. Not thread-safe.
class EnvelopeReader {
 public:
  /// Another stream, tag or epoch forgets the newest key.
  void begin(std::uint32_t stream_id, std::uint8_t tag, std::uint32_t epoch);
  void restart() { newest_.reset(); }

  /// Nothing: it belongs to another chain, or there is a gap before it; then only a join helps.
  std::optional<FrameView> read(const WireFrame& frame);

 private:
  std::uint32_t stream_id_ = 0, epoch_ = 0;
  std::uint8_t tag_ = 0;
  std::optional<ChainClock> newest_;
};

}  // namespace eigencast
