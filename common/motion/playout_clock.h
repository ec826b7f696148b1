// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <deque>
#include <optional>

#include "common/core/clock.h"

namespace eigencast {

/// The clock by which a viewer plays a stream. It maps display times on our clock to media times, which are capture
/// times on the sender's. The fastest pose of the last kWindowUs sets the offset; the others' extra delay is jitter.
///
/// Media time runs at the pace of display time, +-1/kSlew while the clock corrects itself, so that it never stops or
/// runs back. Where it is off by more than kStrayUs (the sender's clock was set, or nothing was shown for long) it
/// jumps. Time comes in as arguments, within +-2^56. Not thread-safe.
class PlayoutClock {
 public:
  static constexpr TimeUs kWindowUs = 3'000'000;
  static constexpr TimeUs kSlew = 20;               ///< 5 %.
  static constexpr std::size_t kMaxArrivals = 512;  ///< That are remembered, however fast they come.
  static constexpr TimeUs kStrayUs = 1'000'000;
  static constexpr TimeUs kLongestSpanUs = 500'000;  ///< A pause is not an interval to wait for.

  /// Takes a pose's times; media times grow from call to call.
  void add(TimeUs media_us, TimeUs arrival_us);
  /// How long to hold a pose for even motion: the interval between poses plus the 95th percentile of the jitter. 0
  /// before the second pose.
  TimeUs full_delay_us() const { return full_delay_us_; }
  /// Likewise with all of the jitter: poses of the last kWindowUs would all have been there.
  TimeUs longest_delay_us() const { return longest_delay_us_; }
  /// Arrival minus media time of the fastest pose.
  TimeUs fastest_us() const { return min_offset_us_; }
  bool started() const { return !arrivals_.empty(); }
  /// The media time to show at `now_us`, poses held for `delay_us`; `lag_us`: now_us minus that instead.
  /// REQUIRES: started().
  TimeUs advance(TimeUs now_us, TimeUs delay_us, std::optional<TimeUs> lag_us = {});
  bool jumped() const { return jumped_; }
  void continue_from(TimeUs media_us, TimeUs now_us) { reading_ = Reading{now_us, media_us}; }
  void reset() { *this = {}; }

 private:
  struct Arrival {
    TimeUs arrival_us;
    TimeUs offset_us;  ///< Arrival minus media time.
    TimeUs span_us;    ///< Media time since the pose before; 0 for the first and after a pause.
  };
  struct Reading {
    TimeUs now_us;
    TimeUs media_us;
  };

  std::deque<Arrival> arrivals_;
  TimeUs newest_media_us_ = 0;
  TimeUs min_offset_us_ = 0;
  TimeUs full_delay_us_ = 0, longest_delay_us_ = 0;
  bool jumped_ = false;  ///< By the last advance().
  std::optional<Reading> reading_;
};

}  // namespace eigencast
