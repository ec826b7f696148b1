// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "broker/relay/frame.h"
#include "broker/relay/generation.h"
#include "common/codec/chain.h"
#include "common/codec/key.h"
#include "common/core/result.h"
#include "common/motion/forecaster.h"
#include "common/motion/pacer.h"
#include "common/wire/control.h"

namespace eigencast::broker {

/// About how long a key or pose takes to encode into so many bytes, its interpolation included.
double encoding_us(const CoefficientLayout& layout, std::size_t bytes);

/// One key of a stream as the publisher sent it, with the codec state before and after it. Immutable; feeds share it.
struct KeyRecord {
  std::uint64_t sequence = 0;
  TimeUs capture_us = 0;
  TimeUs arrival_us = 0;                     ///< On the broker's clock.
  BandMask bands;                            ///< Those in `payload`.
  bool join = false;                         ///< `payload` is that of a join frame.
  std::uint8_t half_spacing = 0;             ///< The sender's latest (see encode_key); 0 before its first key.
  std::uint32_t generation = 0;              ///< Of the memory that `payload` needs; 0: none.
  std::shared_ptr<const ChainState> before;  ///< Null where the chain restarts: receivers need a join.
  std::shared_ptr<const ChainState> after;
  Bytes payload;  ///< As it came.

  ChainClock clock() const { return {sequence, capture_us, after->age_us}; }
  ChainClock clock_before() const;  ///< What receivers know before the key comes.
  /// As recordings and other brokers get it, without id and tag, behind `head`: the key as it came ...
  Bytes frame(Bytes head = {}) const;
  /// ... or `after` as a join. Errors: as encode_join.
  Result<Bytes> join_frame(const CoefficientLayout& layout, Bytes head = {}) const;
};
using KeyRecordPtr = std::shared_ptr<const KeyRecord>;

/// The record for those who do not have its memory: coded anew, to follow `before`, which was made likewise; null: as
/// the first of a chain.
KeyRecordPtr plain_record(const CoefficientLayout& layout, const KeyRecord& record, const KeyRecord* before);

/// Bytes of its values.
std::size_t memory_of(const ChainState& state);
/// Bytes that it takes beside `before`, which the record before has.
std::size_t memory_of(const KeyRecord& record);

/// What the keys of a stream take at most, in bytes, those included that feeds hold until they are due.
std::int64_t keys_bytes(const StreamFormat& format);
/// What a feed has encoded and viewers have not taken, at most, in bytes. REQUIRES: the layout has the profile's bands.
std::int64_t encoded_bytes(const CoefficientLayout& layout, const Profile& profile);

/// Decides which frames the subscribers of one profile get in one epoch, and when; encodes each exactly once.
///   raw           key s on arrival
///   interpolated  key s marked kAhead, which shows the pose (s, 1/k), then step (s, 2/k) ... (s, k/k), evenly paced
///   estimated     key s on arrival, then estimate (s, 1/k), (s, 2/k) ... paced, until key s+1 or max_ahead_us
/// Interpolated poses lie on the profile's curve. Catmull-Rom uses key s+1 for the whole interval if it arrived before
/// the interval's first pose was due, else not at all; its steps carry residuals. Hermite uses the velocities of the
/// format. Not thread-safe.
class Feed {
 public:
  struct Source {
    CoefficientLayout layout;
    VelocityChannels velocities;
    std::uint32_t stream_id = 0;
    std::uint32_t epoch = 0;
    std::uint8_t tag = 0;
    TimeUs max_span_us = 500'000;   ///< Keys further apart are not bridged.
    TimeUs max_ahead_us = 200'000;  ///< Estimates end this long after the newest key.
  };

  /// Counts what residuals took; false: the budget is used up, and their poses, never keys, are left out. 0: asks.
  using Payer = std::function<bool(double work_us)>;

  /// profile  bands within the layout; Hermite only with velocities
  Feed(const Profile& profile, const Source& source, Payer payer);

  /// Keys come as they came to `former`, of the epoch before, whose numbers and times go on. REQUIRES: likewise.
  void keep_pace_of(const Feed& former);

  /// Starts from a key that arrived before this feed existed. REQUIRES: nothing was added yet.
  void begin_at(KeyRecordPtr record);

  void add_key(KeyRecordPtr record, TimeUs now_us, std::vector<FramePtr>& out);
  void leave_gap() { gap_ = true; }  ///< A key is not added: what follows does not build on those before it.

  /// Appends the frames due by now: every key, but only the newest of several poses.
  void pump(TimeUs now_us, std::vector<FramePtr>& out);

  std::optional<TimeUs> next_due_us() const;

  /// The current join frame, encoded once: `work_us` grows by about what that took. Null before the first key.
  FramePtr join(double* work_us = nullptr);

  const Profile& profile() const { return profile_; }
  /// Poses since the last call that were not encoded: beyond the codec's range, or not paid for.
  std::uint64_t take_failed_poses() { return std::exchange(failed_poses_, 0); }

 private:
  /// `overtaken`: a newer pose is due already.
  void emit_due(const Pacer::Due& due, bool overtaken, std::vector<FramePtr>& out);
  /// `ahead`: steps lead up to it, and it shows this one; {0, 0}: nothing.
  void emit_key(KeyRecordPtr record, std::optional<InterpolationStep> ahead, std::vector<FramePtr>& out);
  void pump_estimates(TimeUs now_us, std::vector<FramePtr>& out);
  KeyRecordPtr take_pending();
  /// What a step to the pose carries besides; nothing: the pose is left out. REQUIRES: record.before.
  std::optional<CodedResidual> residual(const KeyRecord& record, const Pacer::Due& due);
  Result<Key> pose_on_curve(const KeyRecord& record, const KeyRecord* next, TimeUs t_us) const;
  /// Describes the record itself, or a pose `due` between keys.
  Envelope envelope(FrameKind kind, const KeyRecord& record, const Pacer::Due* due = nullptr) const;
  void set_last_emitted(KeyRecordPtr record);

  Profile profile_;
  Source source_;
  Payer payer_;
  BandMask mask_;
  Pacer pacer_;                       ///< Paces interpolated poses.
  Forecaster forecaster_;             ///< Paces estimated poses.
  std::deque<KeyRecordPtr> pending_;  ///< Keys that arrived and are not emitted yet; bounded.
  KeyRecordPtr last_emitted_;         ///< The last key emitted.
  /// Catmull-Rom: whether the interval that ends at key `sequence` uses the key after it.
  struct Curve {
    std::uint64_t sequence = 0;
    bool with_next = false;
  };
  std::optional<Curve> curve_;
  bool steps_pending_ = false;  ///< Steps up to last_emitted_ are still due.
  InterpolationStep shown_;     ///< Then: what a join shows.
  FramePtr join_;
  Bytes join_payload_;
  bool gap_ = false;
  std::uint64_t failed_poses_ = 0;
};

}  // namespace eigencast::broker
