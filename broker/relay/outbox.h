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

/// What one connection is owed, and in which order: decides, and leaves the sending to its owner.
///
/// Control messages stand in a bounded queue and are never dropped (overflow: disconnect). Each stream watched has a
/// lane in which at most one key and one pose that nothing builds on (synthetic, step) wait. A newer one replaces an
/// older one of its sort, and a key to be shown as it comes replaces a waiting pose too; what was offered first leaves
/// first. The outbox follows what the receiver can decode: whoever missed a key that the newest frame builds on gets a
/// join frame first, never a backlog.
///
/// A client that acknowledges has in flight at most its round trip plus `window_slack_us` of frames: while the oldest
/// unacknowledged frame is older, the newest wait. One that never acknowledges has no window; frames wait from
/// hold_from() on, where its owner finds that it no longer reads (ReaderWatch).
///
/// Time comes in as an argument. Not thread-safe.
class Outbox {
 public:
  /// A control message as it leaves, framed.
  using Text = std::shared_ptr<const std::string>;
  /// The join frame of a stream's feed as it stands now, or null if it has no key yet.
  using JoinSource = std::function<FramePtr(std::uint32_t stream_id)>;

  struct Limits {
    std::size_t max_control_messages = 256;       ///< Overflow disconnects (default: 256).
    std::size_t max_control_bytes = 1024 * 1024;  ///< Overflow disconnects (default: 1 MiB).
    TimeUs window_slack_us = 100'000;             ///< In flight beyond the round trip (default: 100 ms).
    TimeUs probe_us = 5'000'000;                  ///< A closed window lets one frame through so often (default: 5 s).
    std::size_t max_in_flight = 512;              ///< Unacknowledged frames remembered per lane; older are forgotten.
  };

  /// One message to send: exactly one of the two is set.
  struct Item {
    Text text;
    FramePtr frame;
  };

  struct Skipped {
    std::uint32_t stream_id = 0;
    std::uint64_t frames = 0;
  };

  Outbox() : Outbox(Limits{}) {}
  explicit Outbox(const Limits& limits) : limits_(limits) {}

  /// False: the queue is full and the peer must be disconnected.
  [[nodiscard]] bool push_control(Text text);
  /// For what may be lost (traces): false if it was dropped because a quarter of the queue is in use.
  bool push_droppable(Text text);
  /// An answer to a ping that leaves after all other control messages and takes the place of one that still waits:
  /// where many come, the latest is answered (RFC 6455, 5.5.3).
  void push_late_pong(Text text) { late_pong_ = std::move(text); }

  /// Starts a lane, or starts it anew (new epoch, new profile): the receiver is taken to know nothing.
  void open_lane(std::uint32_t stream_id);
  void close_lane(std::uint32_t stream_id);
  /// Gives back what memory a burst of control messages took.
  void shrink() { control_.shrink_to_fit(); }
  /// Puts a frame into its lane. Ignored if the lane is not open.
  void offer(std::uint32_t stream_id, const FramePtr& frame);

  /// offer() and take() in one for a frame that nothing stands before: true, and it must be sent now; false: nothing
  /// has changed, offer it.
  bool pass(std::uint32_t stream_id, const Frame& frame, TimeUs now_us);

  /// The next message to send now, control first, then the lanes in turn. Nothing: all is sent or waits for
  /// acknowledgements.
  std::optional<Item> take(TimeUs now_us, const JoinSource& join_of);

  /// A frame that was taken did not leave after all: it counts as skipped, and the receiver as not having it.
  void take_back(const Frame& frame);

  void acknowledge(const control::Ack::Item& item, TimeUs now_us);

  /// Frames wait from then on, until it is said anew; ReaderWatch::kNever: they do not. Of who acknowledges: ignored.
  void hold_from(TimeUs when_us) { hold_from_us_ = acknowledges_ ? ReaderWatch::kNever : when_us; }

  /// Frames skipped since the last call, per lane; lanes without any are left out.
  std::vector<Skipped> take_skipped();
  /// What became of a stream's frames since its lane was first opened.
  Ladder::Counts counts(std::uint32_t stream_id);
  std::uint64_t skipped_total() const { return skipped_total_; }
  std::uint64_t joins_total() const { return joins_total_; }
  std::size_t lanes() const { return lanes_.size(); }
  bool acknowledges() const { return acknowledges_; }
  /// The least time between a frame's leaving and its acknowledgement lately; nothing before the first.
  std::optional<TimeUs> round_trip_us() const;
  std::size_t control_messages() const { return control_.size(); }

 private:
  struct InFlight {
    std::uint64_t sequence;
    std::uint8_t step;
    TimeUs sent_us;
  };
  struct Lane {
    std::uint32_t stream_id = 0;
    FramePtr key;                         ///< Waits to leave; a key or a join.
    FramePtr pose;                        ///< Waits to leave; a synthetic or a step.
    bool pose_first = false;              ///< The pose was offered before the key.
    bool wants_join = true;               ///< The receiver has nothing of this lane yet.
    InFlight last{0, 0, -1};              ///< Sent last; all that is remembered before the first acknowledgement.
    std::optional<std::uint64_t> newest;  ///< Sequence of the newest key that the receiver has.
    std::vector<InFlight> in_flight;      ///< Oldest first.
    TimeUs last_sent_us = 0;
    std::uint64_t skipped = 0;  ///< Since they were last taken.
    Ladder::Counts counts;
  };

  Lane* find(std::uint32_t stream_id);
  bool window_closed(const Lane& lane, TimeUs now_us) const;
  FramePtr next_of(Lane& lane, const JoinSource& join_of);
  void drop_overtaken(Lane& lane);
  void note_sent(Lane& lane, const Frame& frame, TimeUs now_us);
  void note_in_flight(Lane& lane);
  void begin_window(Lane& lane, const control::Ack::Item& item, TimeUs now_us);
  void note_round_trip(TimeUs round_trip_us, TimeUs now_us);
  /// Empties a place in the lane and counts what was in it as skipped.
  void skip(Lane& lane, FramePtr& waiting);

  Limits limits_;
  std::vector<Text> control_;  ///< Oldest first.
  Text late_pong_;
  TimeUs hold_from_us_ = ReaderWatch::kNever;
  std::size_t control_bytes_ = 0;
  std::vector<Lane> lanes_;
  std::size_t turn_ = 0;
  bool acknowledges_ = false;
  std::optional<TimeUs> least_now_;     ///< Least round trip in the present period.
  std::optional<TimeUs> least_before_;  ///< In the period before it.
  TimeUs period_start_us_ = 0;
  std::uint64_t skipped_total_ = 0;
  std::uint64_t joins_total_ = 0;
};

}  // namespace eigencast::broker
