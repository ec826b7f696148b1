// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "broker/relay/frame.h"
#include "broker/relay/ladder.h"
#include "broker/relay/reader_watch.h"
#include "common/wire/control.h"

namespace eigencast::broker {

/// The send queue of one connection: decides what is sent next and what a slow viewer skips. Not thread-safe.
///
/// Backpressure: control messages wait in a bounded queue and are never dropped (overflow: disconnect). Each watched
/// stream has a lane of two slots: one key, and one pose that nothing builds on (step, estimate). A newer frame
/// replaces an older one in its slot; a key to be shown at once also replaces the waiting pose. Frames leave in the
/// order they were offered. A receiver that missed a key gets a join frame next, never a backlog.
///
/// A client that acknowledges has at most its round trip plus `window_slack_us` of frames in flight; newer frames wait.
/// A client that never acknowledges has no window; its frames wait from hold_from() on (see ReaderWatch).
class Outbox {
 public:
  using Text = std::shared_ptr<const std::string>;
  using JoinSource = std::function<FramePtr(std::uint32_t stream_id)>;

  struct Limits {
    std::size_t max_control_messages = 256;       ///< Overflow disconnects (default: 256).
    std::size_t max_control_bytes = 1024 * 1024;  ///< Overflow disconnects (default: 1 MiB).
    TimeUs window_slack_us = 100'000;             ///< In flight beyond the round trip (default: 100 ms).
    TimeUs max_round_trip_us = 2'000'000;         ///< A longer one counts as this (default: 2 s).
    TimeUs probe_us = 5'000'000;                  ///< A closed window passes one frame per period (default: 5 s).
    std::size_t max_in_flight = 64;             ///< Unacknowledged frames remembered per lane: beyond, every other.
  };

  static constexpr std::size_t kTextBytes = 64;  ///< What a Text takes besides its characters.

  struct Item {  ///< One of the two is set.
    Text text;
    FramePtr frame;
  };

  struct Dropped {
    std::uint32_t stream_id = 0;
    std::uint64_t frames = 0;
  };

  Outbox() : Outbox(Limits{}) {}
  explicit Outbox(const Limits& limits) : limits_(limits) {}

  /// False: the queue is full and the peer must be disconnected.
  [[nodiscard]] bool push_control(Text text);
  /// For messages that may be lost (traces). False: dropped, because a quarter of the queue is in use.
  bool push_droppable(Text text);
  /// Queues a pong: as a droppable message, else (false) behind all other control messages, where it replaces the one
  /// that waits: of many pings only the latest needs an answer (RFC 6455, 5.5.3).
  bool push_pong(Text pong);

  /// Opens a lane or resets it (new epoch, new profile): the receiver is assumed to have nothing.
  void open_lane(std::uint32_t stream_id);
  void close_lane(std::uint32_t stream_id);
  void shrink() { control_.shrink_to_fit(); }
  /// Ignored if the lane is not open.
  void offer(std::uint32_t stream_id, const FramePtr& frame);

  /// offer() and take() in one, if nothing is queued before the frame and no other lane is open. False: nothing
  /// changed, offer it.
  bool send_directly(std::uint32_t stream_id, const Frame& frame, TimeUs now_us);

  /// The next control message, if there is one.
  std::optional<Item> take_control();
  /// The next message to send: control first, then the lanes in turn. Nothing: all is sent or waits for the window.
  std::optional<Item> take(TimeUs now_us, const JoinSource& join_of);

  /// A frame that take() returned was not written; the receiver does not have it. The last pose waits again, so that a
  /// receiver shows it even if the sender pauses; all others count as dropped.
  void drop_unsent(const FramePtr& frame);

  void acknowledge(const control::Ack::Item& item, TimeUs now_us);

  /// Frames wait from then on; ReaderWatch::kNever: they do not. Ignored for clients that acknowledge.
  void hold_from(TimeUs when_us) { hold_from_us_ = acknowledges_ ? ReaderWatch::kNever : when_us; }
  /// Frames of all clients wait until then.
  void hold_until(TimeUs when_us) { hold_until_us_ = when_us; }
  bool is_held(TimeUs now_us) const { return now_us < hold_until_us_; }
  /// Leaves out so many frames, and what waits, for a fraction of what offer() and take() do: a join comes next.
  void miss(std::uint32_t stream_id, std::size_t frames);

  /// Frames dropped since the last call, of at most so many lanes, in turn; lanes without any are left out.
  std::vector<Dropped> take_dropped(std::size_t most);
  Ladder::Counts counts(std::uint32_t stream_id);
  std::uint64_t dropped_total() const { return dropped_total_; }
  std::uint64_t joins_total() const { return joins_total_; }
  std::size_t lanes() const { return lanes_.size(); }
  /// Lanes that may have something to send, unless frames wait.
  std::size_t waiting(TimeUs now_us) const { return frames_wait(now_us) ? 0 : waiting_.size() - closed_; }
  /// Whether take() may have to make a join for any of them.
  bool needs_join();
  bool acknowledges() const { return acknowledges_; }
  /// The least recent time from sending a frame to its acknowledgement; nothing before the first.
  std::optional<TimeUs> round_trip_us() const;
  std::size_t control_messages() const { return control_.size(); }
  /// Memory of the control messages that wait.
  std::size_t control_memory() const { return control_bytes_ + control_.size() * kTextBytes; }

 private:
  struct InFlight {
    std::uint64_t sequence;
    InterpolationStep step;
    TimeUs sent_us;
  };
  struct Lane {
    std::uint32_t stream_id = 0;
    bool pose_first = false;              ///< The pose was offered before the key.
    bool wants_join = true;               ///< The receiver has nothing of this lane yet.
    bool waits = false;                   ///< Its stream is in waiting_: it has a frame, or wants a join.
    FramePtr key;                         ///< Waiting key or join.
    FramePtr pose;                        ///< Waiting step or estimate.
    std::optional<std::uint64_t> newest;  ///< Sequence of the newest key that the receiver has.
    std::uint64_t joined = 0;             ///< Sequence of the latest join made for it ...
    std::uint8_t joined_at = 0;           ///< ... and the last step up to it that is shown with it.
    InFlight last{0, {}, -1};             ///< The last frame sent; the only one kept before the first acknowledgement.
    Ladder::Counts counts;
    std::vector<InFlight> in_flight;  ///< Oldest first.
    std::uint64_t dropped = 0;        ///< Since they were last taken.
  };

  Lane* find(std::uint32_t stream_id);
  /// The slot that leaves next; null: none waits.
  static FramePtr& first_of(Lane& lane) { return lane.key && !(lane.pose && lane.pose_first) ? lane.key : lane.pose; }
  void wait(Lane& lane);
  void open_window(const Lane& lane);
  void open_windows() { closed_ = 0, reopen_us_ = ReaderWatch::kNever; }
  static bool decodable(const Frame& frame, std::optional<std::uint64_t> newest) {
    return frame.envelope.kind == FrameKind::kJoin || (newest && *newest == frame.builds_on);
  }
  /// A join may overtake frames that were made before it and are offered after it.
  static bool is_overtaken(const Lane& lane, const Frame& frame) {
    const Envelope& head = frame.envelope;
    const bool step_is_past =
        head.kind == FrameKind::kStep && head.sequence == lane.joined && head.step.at <= lane.joined_at;
    return lane.newest && (frame.builds_on < *lane.newest || step_is_past);
  }
  bool frames_wait(TimeUs now_us) const { return now_us >= hold_from_us_ || is_held(now_us); }
  bool window_closed(const Lane& lane, TimeUs now_us) const {
    return acknowledges_ && in_flight_too_long(lane, now_us);
  }
  bool in_flight_too_long(const Lane& lane, TimeUs now_us) const;
  FramePtr next_of(Lane& lane, const JoinSource& join_of);
  void drop_overtaken(Lane& lane);
  void note_sent(Lane& lane, const Frame& frame, TimeUs now_us);
  void note_in_flight(Lane& lane);
  void begin_window(Lane& lane, const control::Ack::Item& item, TimeUs now_us);
  void note_round_trip(TimeUs round_trip_us, TimeUs now_us);
  void skip(Lane& lane, FramePtr& waiting);

  std::vector<Lane> lanes_;             ///< By stream_id.
  std::vector<std::uint32_t> waiting_;  ///< Streams whose lanes have something to send: with a closed window, in turn.
  std::vector<Text> control_;  ///< Oldest first.
  TimeUs hold_from_us_ = ReaderWatch::kNever;
  TimeUs hold_until_us_ = 0;
  bool acknowledges_ = false;
  Limits limits_;
  Text late_pong_;
  std::size_t control_bytes_ = 0;
  std::uint32_t told_dropped_ = 0;          ///< The last stream of take_dropped().
  std::size_t closed_ = 0;                   ///< Of waiting_: found closed, and so until ...
  TimeUs reopen_us_ = ReaderWatch::kNever;  ///< ... then, or an acknowledgement.
  std::optional<TimeUs> min_round_trip_;           ///< In the current period.
  std::optional<TimeUs> previous_min_round_trip_;  ///< In the period before it.
  TimeUs period_start_us_ = 0;
  std::uint64_t dropped_total_ = 0;
  std::uint64_t joins_total_ = 0;
};

// What every delivery runs is inline.

inline bool Outbox::send_directly(std::uint32_t stream_id, const Frame& frame, TimeUs now_us) {
  if (lanes_.size() != 1 || !control_.empty()) return false;
  Lane& lane = *lanes_.begin();
  if (lane.stream_id != stream_id || lane.waits) return false;
  if (!decodable(frame, lane.newest) || frames_wait(now_us) || window_closed(lane, now_us)) return false;
  if (frame.envelope.kind == FrameKind::kStep && is_overtaken(lane, frame)) return false;
  note_sent(lane, frame, now_us);
  return true;
}

inline void Outbox::note_sent(Lane& lane, const Frame& frame, TimeUs now_us) {
  if (frame.envelope.is_key()) lane.newest = frame.envelope.sequence;
  ++lane.counts.sent;
  lane.last = {frame.envelope.sequence, frame.envelope.step, now_us};
  if (acknowledges_) note_in_flight(lane);
}

}  // namespace eigencast::broker
