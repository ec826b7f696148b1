// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "common/core/clock.h"
#include "common/motion/pacer.h"

namespace eigencast {

/// Decides when the broker makes estimates beyond the newest key, so that k poses per key interval are shown in time
/// although keys come with jitter, and although some do not come at all. Nothing is held: keys leave when they come,
/// and an estimate of media time m is due at m + delay.
///
/// The delay is the 90th percentile of (arrival - capture) of the keys of the last kWindowUs, but no more than half a
/// key interval above the least of them: a key that is later than that is stood in for by estimates. It grows at once
/// and shrinks by at most 1/kSlew of the time that passes.
///
///   missing, late key   estimates go on at the same pace, at most `max_ahead_us` and kMaxPerKey beyond the newest key;
///                       then the last one stands.
///   key that came late  estimates go on from it, after the media time of those that have left: never back in time.
///   burst               only the newest key has estimates to come.
///   gap, order, clock   a key that does not follow the one before it within `max_span_us`, or whose sequence or
///                       capture time does not grow, has no direction: estimates begin with the next one. Arrivals that
///                       stray from the delay by more than kStrayUs begin it anew.
///
/// Time comes in as arguments; holds no pose data. Not thread-safe.
class Forecaster {
 public:
  static constexpr TimeUs kWindowUs = 3'000'000;
  static constexpr TimeUs kSlew = 32;
  static constexpr TimeUs kStrayUs = 1'000'000;
  static constexpr int kMaxPerKey = 15;  ///< As many as the envelope can number.

  /// k  poses per key interval, 1..15
  /// max_ahead_us  estimates end so long after the newest key (default: 200 ms)
  /// max_span_us  keys further apart give no direction (default: 500 ms)
  explicit Forecaster(std::uint8_t k, TimeUs max_ahead_us = 200'000, TimeUs max_span_us = 500'000);

  void add_key(std::uint64_t sequence, TimeUs capture_us, TimeUs arrival_us);
  /// The next estimate if it is due: Due{newest key, at, k, media time, due time}, at/k key intervals beyond the key.
  std::optional<Pacer::Due> pop_due(TimeUs now_us);
  std::optional<TimeUs> next_due_us() const;
  void reset();

  /// The delay in force; nothing before the first key.
  std::optional<TimeUs> delay_us() const { return delay_us_; }

 private:
  struct Sample {
    TimeUs arrival_us;
    TimeUs offset_us;  ///< Arrival minus capture.
  };
  struct LastKey {
    std::uint64_t sequence;
    TimeUs capture_us;
    TimeUs arrival_us;
  };
  void follow(TimeUs capture_us, TimeUs arrival_us, TimeUs interval_us);
  std::optional<Pacer::Due> next() const;

  std::uint8_t k_;
  TimeUs max_ahead_us_;
  TimeUs max_span_us_;
  std::optional<LastKey> last_;
  TimeUs interval_us_ = 0;  ///< Between the two newest keys; 0: no direction.
  int next_at_ = 1;
  std::optional<TimeUs> left_us_;  ///< Media time of the newest pose that has left.
  std::optional<TimeUs> delay_us_;
  std::deque<Sample> samples_;
};

}  // namespace eigencast
