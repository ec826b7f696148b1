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
  kStep = 3,  ///< The pose at `step` between key sequence-1 and key sequence: Interp of them, plus a residual if any.
  kEstimate = 4,  ///< The pose step.at / step.of key intervals beyond key `sequence`. No payload.
};

/// The position of a pose between two keys: `at` of `of` equal steps from key sequence-1 to key sequence.
/// {0, 0} on keys and joins that are shown themselves, or that show nothing; on estimates the way goes on from key
/// sequence, and `at` may exceed `of`. One byte on the wire: at in the high four bits, of in the low.
struct InterpolationStep {
  std::uint8_t at = 0;  ///< 1..of; 1..15 on estimates
  std::uint8_t of = 0;  ///< 0 (no interpolation) or 1..15
  std::uint8_t byte() const { return static_cast<std::uint8_t>(at << 4 | (of & 15)); }
  bool operator==(const InterpolationStep&) const = default;
};

/// What is known of a frame besides its payload. On the wire it takes 5 to 10 bytes, of joins up to 23: the rest
/// follows from the receiver's newest key (ChainClock).
struct Envelope {
  static constexpr std::size_t kMaxBytes = 37;
  static constexpr std::size_t kKeyBytes = 6;  ///< Of a key of an even stream whose id is below 128.
  /// Flag of a key or join that steps lead up to: the pose at `step` is shown in its place, or nothing.
  static constexpr std::uint8_t kAhead = 1;
  /// Flag of a key that a memory predicts, and of a join whose newer key it predicted (see PoseMemory).
  static constexpr std::uint8_t kRecalled = 4;

  FrameKind kind = FrameKind::kKey;
  std::uint8_t flags = 0;       ///< kAhead, kRecalled.
  BandMask bands;               ///< Those in the payload. None on kEstimate; on kStep those with a residual.
  InterpolationStep step;       ///< Set on steps, estimates, and keys and joins that show a pose that leads up to them.
  std::uint32_t stream_id = 0;  ///< Given by the broker.
  std::uint32_t epoch = 0;      ///< Given by the broker; names the asset.
  std::uint64_t sequence = 0;   ///< Numbers the key that this frame is, or leads up to. Consecutive keys differ by one.
  TimeUs capture_us = 0;        ///< When the key or pose holds, microseconds on the sender's clock.
  std::uint8_t tag = 0;         ///< Stands for the epoch on the wire.
  TimeUs age_us = 0;            ///< Keys and joins: capture time of this key minus that of the key before it.

  bool is_key() const { return kind == FrameKind::kKey || kind == FrameKind::kJoin; }
  bool is_ahead() const { return (flags & kAhead) != 0; }
  bool is_recalled() const { return (flags & kRecalled) != 0; }
  /// Whether a pose is shown when it comes.
  bool shows() const { return !is_ahead() || step.of != 0; }
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

  /// The clock once `key`, a key or join, has come.
  static ChainClock after(const Envelope& key) { return {key.sequence, key.capture_us, key.age_us}; }
  bool operator==(const ChainClock&) const = default;
};

/// at / of of a time, rounded down; exact for all times within limits::kMaxTimeUs. REQUIRES: of > 0.
constexpr TimeUs part_of(TimeUs span_us, InterpolationStep step) {
  return span_us / step.of * step.at + span_us % step.of * step.at / step.of;
}

/// When the pose holds that a key or join sent ahead shows.
constexpr TimeUs shown_us(const Envelope& key) {
  return key.capture_us - key.age_us + part_of(key.age_us, key.step);
}

/// Writes an envelope at the end of `out`. `newest`: of the receivers, before the frame; may be null but for keys.
/// REQUIRES: what resolved() checks.
void append_envelope(const Envelope& envelope, const ChainClock* newest, Bytes& out);

/// A frame as it came: what it says itself.
struct WireFrame {
  Envelope envelope;       ///< Sequence and times of joins alone; no epoch.
  std::uint8_t check = 0;  ///< Low byte of the sequence; not of joins.
  TimeUs delay_us = 0;     ///< Keys: capture time beyond the expected one.
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
