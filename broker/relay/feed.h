// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "broker/relay/frame.h"
#include "common/codec/chain.h"
#include "common/codec/schemes.h"
#include "common/core/result.h"
#include "common/motion/forecaster.h"
#include "common/motion/pacer.h"
#include "common/wire/control.h"

namespace eigencast::broker {

/// One key of a stream as the publisher sent it, with the codec state on both sides of it. Immutable and shared by all
/// feeds.
struct KeyRecord {
  std::uint64_t sequence = 0;
  TimeUs capture_us = 0;
  TimeUs arrival_us = 0;          ///< On the broker's clock.
  BandMask bands;                 ///< Of `payload`.
  bool join = false;              ///< `payload` is that of a join frame.
  std::uint8_t half_spacing = 0;  ///< The sender's latest (see encode_key); 0 before its first key.
  std::shared_ptr<const ChainState>
      before;  ///< Nothing where the chain begins anew: receivers cannot go on from before.
  std::shared_ptr<const ChainState> after;
  Bytes payload;  ///< As it came.
};
using KeyRecordPtr = std::shared_ptr<const KeyRecord>;

/// Decides which frames the subscribers of one profile of one epoch get, and when, and makes each exactly once.
///
///   raw        key s as it comes
///   full       synthetic (s, 1/k) ... (s, (k-1)/k), key s, evenly paced
///   compact    key s marked kAhead as soon as the steps before it have left, then step (s, 1/k) ... (s, k/k), paced
///   estimated  key s as it comes, then estimate (s, 1/k), (s, 2/k) ... paced, until key s+1 comes or max_ahead_us is
///              over
///
/// Interpolated poses lie on the profile's curve. Catmull-Rom takes key s+1 where it came before the first pose of the
/// interval was due, and does without it for the whole interval where not; Hermite takes the velocities of the format.
/// Time comes in as an argument; no sockets. Not thread-safe.
class Feed {
 public:
  /// What of a stream concerns all its feeds.
  struct Source {
    CoefficientLayout layout;
    VelocityChannels velocities;
    std::uint32_t stream_id = 0;
    std::uint32_t epoch = 0;
    TimeUs max_span_us = 500'000;   ///< Keys further apart are not bridged.
    TimeUs max_ahead_us = 200'000;  ///< Estimates end so long after the newest key.
  };

  /// profile  with bands no more than the layout has, and Hermite only where there are velocities
  Feed(const Profile& profile, const Source& source);

  /// Begins at a key that came before this feed existed: join() gives it at once, what follows is bridged from it.
  /// REQUIRES: nothing was added yet.
  void begin_at(KeyRecordPtr record);

  /// Takes the next key and appends the frames that leave now to `out`.
  void add_key(KeyRecordPtr record, TimeUs now_us, std::vector<FramePtr>& out);

  /// Appends the frames due by now: every key in its turn, but of several poses only the newest.
  void pump(TimeUs now_us, std::vector<FramePtr>& out);

  /// When pump() has something to do next; nothing while nothing is pending.
  std::optional<TimeUs> next_due_us() const;

  /// Makes poses that wait for nothing but their time: soon after a key came, all that they are made of is in the
  /// processor's caches, which it is not when they are due. Changes nothing but when the work is done; does nothing
  /// while the caller is behind, since poses that are overtaken are not made at all.
  void prepare();
  /// Poses that are made and wait for their time.
  std::size_t poses_ahead() const { return ahead_.size(); }

  /// The join frame that brings a receiver to where this feed stands now; made once per state. Null before the first
  /// key.
  FramePtr join();

  const Profile& profile() const { return profile_; }
  /// Poses that were due but could not be coded (a value beyond the codec's range), since the last call.
  std::uint64_t take_failed_poses() { return std::exchange(failed_poses_, 0); }

 private:
  /// `overtaken`: a newer pose is due by now as well.
  void pump_full(const Pacer::Due& due, bool overtaken, std::vector<FramePtr>& out);
  void pump_compact(const Pacer::Due& due, bool overtaken, std::vector<FramePtr>& out);
  void emit_key(KeyRecordPtr record, std::uint8_t flags, std::vector<FramePtr>& out);
  void emit_coming_ahead(std::vector<FramePtr>& out);
  void pump_estimates(TimeUs now_us, std::vector<FramePtr>& out);
  void emit_synthetic(const KeyRecord& record, const Pacer::Due& due, std::vector<FramePtr>& out);
  void emit_estimate(const Pacer::Due& due, std::vector<FramePtr>& out);
  /// Null if it cannot be coded.
  FramePtr synthetic(const KeyRecord& record, const Pacer::Due& due);
  /// A pose that is no reference, coded against `state` more coarsely than a key of `key_spacing`, and cut to the
  /// profile's bands. Null if it cannot be coded.
  FramePtr made(Envelope head, std::uint8_t key_spacing, const ChainState& state, Result<Key> pose) const;
  FramePtr take_ahead(const Pacer::Due& due);
  void emit_made(FramePtr frame, std::vector<FramePtr>& out);
  Result<Key> pose_between(const KeyRecord& record, const Pacer::Due& due);
  Result<Key> pose_on_curve(const KeyRecord& record, const KeyRecord* next, TimeUs t_us) const;
  Envelope envelope(FrameKind kind, const KeyRecord& record) const;
  void stand_at(KeyRecordPtr record);

  Profile profile_;
  Source source_;
  BandMask mask_;
  Pacer pacer_;                      ///< Of interpolated poses.
  Forecaster forecaster_;            ///< Of estimated ones.
  std::deque<KeyRecordPtr> coming_;  ///< Keys that came and have not left; bounded.
  std::deque<FramePtr> ahead_;       ///< Synthetic poses made before they are due, in order; at most kMostAhead.
  bool behind_ = false;              ///< Poses were overtaken since the last key that left in its time.
  KeyRecordPtr stands_at_;           ///< The last key that left.
  /// Catmull-Rom: whether the interval that leads up to key `sequence` is drawn with the key after it.
  struct Curve {
    std::uint64_t sequence = 0;
    bool with_next = false;
  };
  std::optional<Curve> curve_;
  bool steps_pending_ = false;  ///< Compact: steps up to stands_at_ are still to leave.
  FramePtr join_;
  std::uint64_t failed_poses_ = 0;
};

}  // namespace eigencast::broker
