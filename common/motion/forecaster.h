// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "common/core/clock.h"
#include "common/motion/pacer.h"

namespace eigencast {

/// Decides when the broker estimates poses beyond the newest key, so that k poses per key interval arrive in time
/// although keys are late or missing. Keys are forwarded at once; an estimate of media time m is due at m + delay.
///
/// The delay is the 90th percentile of (arrival - capture) over the last kWindowUs, at most half a key interval above
/// the minimum: estimates replace later keys. It grows at once and shrinks by at most 1/kSlew of the time that passes.
///
///   missing, late key   estimates continue at the same pace, at most `max_ahead_us` and kMaxPerKey beyond the newest
///                       key; then the last one is held
///   key that came late  estimates continue from it, after the media time already emitted: never back in time
///   burst               only the newest key gets estimates
///   gap, order, clock   a key that does not follow its predecessor within `max_span_us`, or whose sequence or capture
///                       time does not grow, has no direction: estimates begin with the next one. An arrival more than
///                       kStrayUs off the delay restarts the delay.
///
/// Time comes in as arguments; holds no pose data. Not thread-safe.
class Forecaster {
 public:
  static constexpr TimeUs kWindowUs = 3'000'000;  ///< Arrivals that the delay is taken from.
  static constexpr TimeUs kSlew = 32;             ///< The delay shrinks by at most 1/kSlew of the time that passes.
  static constexpr TimeUs kStrayUs = 1'000'000;   ///< An arrival further off the delay restarts it.
  static constexpr int kMaxPerKey = 15;           ///< The envelope numbers no more.

  /// k             poses per key interval, 1..15
  /// max_ahead_us  how long after the newest key estimates end
  /// max_span_us   keys further apart give no direction
  explicit Forecaster(std::uint8_t k, TimeUs max_ahead_us = 200'000, TimeUs max_span_us = 500'000);

  void add_key(std::uint64_t sequence, TimeUs capture_us, TimeUs arrival_us);
  /// The next estimate if it is due: Due{newest key, at, k, media time, due time}, at/k key intervals beyond the key.
  std::optional<Pacer::Due> pop_due(TimeUs now_us);
  std::optional<TimeUs> next_due_us() const;
  void reset();
  /// Nothing before the first key.
  std::optional<TimeUs> delay_us() const { return delay_us_; }

 private:
  struct Sample {
    TimeUs arrival_us;
    TimeUs offset_us;  ///< Arrival minus capture.
  };
  void follow(TimeUs capture_us, TimeUs arrival_us, TimeUs interval_us);
  std::optional<Pacer::Due> next() const;

  std::uint8_t k_;
  TimeUs max_ahead_us_;
  TimeUs max_span_us_;
  std::optional<Pacer::KeyTimes> last_;
  TimeUs interval_us_ = 0;  ///< Between the two newest keys; 0: no direction.
  int next_at_ = 1;
  std::optional<TimeUs> last_emitted_us_;  ///< Media time of the newest emitted pose.
  std::optional<TimeUs> delay_us_;
  std::deque<Sample> samples_;
};

}  // namespace eigencast
