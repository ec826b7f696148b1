// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "common/core/clock.h"

namespace eigencast {

/// Decides when the broker emits the poses between keys, so that k poses per key interval are even in time although
/// keys arrive with jitter. Interpolation between key s-1 and key s needs key s (curves also key s+1): a pose of media
/// time m is due at m + delay, where delay follows (arrival - capture) of the keys plus one key interval, or two.
///
///   jitter      the delay is the largest that a key of the last kWindowUs needed; it grows at once and shrinks by at
///               most 1/kSlew of the time that passes. Clock drift is followed in the same way.
///   late key    up to one key interval the whole schedule moves back. Beyond that expired poses are not made; the key
///               itself always is. Three such keys in a row that are not a burst: restart.
///   burst       at most two key intervals wait (three with a further key); the oldest is dropped.
///   pause, gap  a key more than max_span_us after its predecessor, or without it, is not bridged: only the key is due.
///   restart     a key whose sequence or capture time does not grow, or an unbridged one that would wait longer than
///               max_span_us (the sender's clock was set forward), clears queue and history; it is due on arrival, as
///               is the first key.
/// Due times never go back, except by a restart.
///
/// Time comes in as arguments; holds no pose data. Not thread-safe.
class Pacer {
 public:
  /// Step at/of from key sequence-1 to key sequence (at == of is the key itself).
  struct Due {
    std::uint64_t sequence = 0;
    std::uint8_t at = 0;
    std::uint8_t of = 0;
    TimeUs capture_us = 0;  ///< Interpolated.
    TimeUs due_us = 0;
  };

  struct KeyTimes {
    std::uint64_t sequence;
    TimeUs capture_us;
    TimeUs arrival_us;
  };

  static constexpr TimeUs kWindowUs = 3'000'000;    ///< How long a key's delay counts.
  static constexpr TimeUs kSlew = 32;               ///< The delay shrinks by 1/32 of the time that passes (3 %).
  static constexpr std::size_t kMaxArrivals = 512;  ///< Arrivals of keys that are remembered, however fast they come.

  /// k             poses per key interval, 1..15
  /// max_span_us   keys further apart than this are not bridged: only the later key itself becomes due
  /// further_keys  keys after key s that its interval waits for: 0 or 1. The wait follows the recent delays: a pose is
  ///               due whether its further key has come or not.
  explicit Pacer(std::uint8_t k, TimeUs max_span_us = 500'000, int further_keys = 0);

  void add_key(std::uint64_t sequence, TimeUs capture_us, TimeUs arrival_us);
  /// The next pose if it is due at `now_us`; call until it returns nothing.
  std::optional<Due> pop_due(TimeUs now_us);
  std::optional<TimeUs> next_due_us() const;
  /// The queue, next first; valid until the next call of another member.
  const std::deque<Due>& waiting() const { return queue_; }
  /// Forgets everything, as at a new epoch.
  void reset();
  /// Poses dropped or never made because newer ones overtook them.
  std::uint64_t dropped() const { return dropped_; }

 private:
  struct Sample {
    TimeUs arrival_us;
    TimeUs need_us;  ///< Arrival, plus the intervals of further keys, minus the media time of the first waiting pose.
    TimeUs span_us;  ///< Capture time since the key before.
  };

  void restart(std::uint64_t sequence, TimeUs capture_us, TimeUs arrival_us);
  void bridge(std::uint64_t sequence, TimeUs capture_us, TimeUs arrival_us);
  TimeUs delay_from(const Sample& sample);
  void push(const Due& due);

  std::uint8_t k_;
  TimeUs max_span_us_;
  int further_keys_;
  std::optional<KeyTimes> last_;
  std::optional<TimeUs> delay_us_;
  std::deque<Sample> samples_;  ///< From the last kWindowUs, at most kMaxArrivals.
  int late_in_a_row_ = 0;
  TimeUs last_due_us_ = 0;
  std::uint64_t dropped_ = 0;
  std::deque<Due> queue_;
};

}  // namespace eigencast
