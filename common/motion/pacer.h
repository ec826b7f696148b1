// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "common/core/clock.h"

namespace eigencast {

/// Decides when the poses between keys leave the broker, so that k poses per key interval come evenly in time although keys
/// come with jitter. Interpolation between key s-1 and key s can begin only when key s is there: a pose of media time m
/// leaves at m + delay, where delay follows (arrival - capture) of the keys plus one key interval.
///
/// Time comes in as arguments; holds no pose data. Not thread-safe.
class Pacer {
 public:
  /// One pose that is due: step at/of from key sequence-1 to key sequence (at == of is the key itself).
  struct Due {
    std::uint64_t sequence = 0;
    std::uint8_t at = 0;
    std::uint8_t of = 0;
    TimeUs capture_us = 0;  ///< Interpolated capture time.
    TimeUs due_us = 0;      ///< When it should leave.
  };

  /// k  poses per key interval, 1..15.
  /// max_span_us  keys further apart than this are not bridged: only the later key itself becomes due (default: 500 ms).
  explicit Pacer(std::uint8_t k, TimeUs max_span_us = 500'000);

  /// A key came. Keys out of order (sequence or capture time not growing) restart the schedule at this key.
  void add_key(std::uint64_t sequence, TimeUs capture_us, TimeUs arrival_us);

  /// The next pose if it is due at `now`; call until it returns nothing. Poses that a full newer interval has overtaken are
  /// dropped: the queue never holds more than two key intervals.
  std::optional<Due> pop_due(TimeUs now_us);

  /// When pop_due will next have something; nothing if the queue is empty.
  std::optional<TimeUs> next_due_us() const;

  /// Forgets everything, as at a new epoch.
  void reset();

 private:
  struct LastKey {
    std::uint64_t sequence;
    TimeUs capture_us;
  };
  std::uint8_t k_;
  TimeUs max_span_us_;
  std::optional<LastKey> last_;
  TimeUs delay_us_ = 0;
  bool has_delay_ = false;
  std::deque<Due> queue_;
};

}  // namespace eigencast
