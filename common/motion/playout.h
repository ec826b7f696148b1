// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>

#include "common/motion/interpolation.h"

namespace eigencast {

/// How a client turns poses that come at their own times into a pose for each display time.
enum class PlayoutMode : std::uint8_t {
  kLatest,       ///< Show the newest pose as it is: no added delay, motion as even as the arrivals.
  kInterpolate,  ///< Hold poses for a short playout delay and interpolate between them (Eq. 7).
  kEstimate,     ///< Run ahead of the newest pose by Eq. 9, at most max_ahead_us.
};

/// A jitter buffer and playout clock for one stream. Media times are capture times on the sender's clock, display times
/// are on ours. The clock is learnt from arrivals: it follows the least (arrival - media) of the last kWindowUs, and in
/// kInterpolate stays behind it by the playout delay. It corrects itself by at most 1/kSlew of the time that passes, so
/// that media time never runs back; where arrivals stray from it by more than kStrayUs it starts anew.
///
/// Time comes in as arguments. Holds at most kMaxPoses poses; the oldest goes first. Not thread-safe.
class Playout {
 public:
  static constexpr std::size_t kMaxPoses = 64;
  static constexpr TimeUs kWindowUs = 3'000'000;
  static constexpr TimeUs kSlew = 20;  ///< 5 %.
  static constexpr TimeUs kStrayUs = 1'000'000;

  /// delay_us  playout delay of kInterpolate; 0 (the default) follows the stream: one interval between poses plus the
  ///           95th percentile of the jitter.
  /// max_ahead_us  how far kEstimate runs ahead of the newest pose before it holds (default: 100 ms).
  explicit Playout(PlayoutMode mode, TimeUs delay_us = 0, TimeUs max_ahead_us = 100'000);

  void set_mode(PlayoutMode mode) { mode_ = mode; }
  PlayoutMode mode() const { return mode_; }

  /// A pose came at `arrival_us`. One whose time is not after the newest is dropped (returns false). A pose of another
  /// size than those before it replaces them all.
  bool add(TimedPose pose, TimeUs arrival_us);

  /// The pose to show at `now_us`; nothing before the first one came. Its time_us is the media time that it shows.
  std::optional<TimedPose> at(TimeUs now_us) const;

  /// The playout delay in force: what kInterpolate adds.
  TimeUs delay_us() const;

  /// Forgets all poses, as at a new epoch.
  void reset();

 private:
  struct Arrival {
    TimeUs arrival_us;
    TimeUs offset_us;  ///< Arrival minus media time.
    TimeUs span_us;    ///< Media time since the pose before; 0 for the first and after a pause.
  };
  void follow(TimeUs media_us, TimeUs arrival_us);

  PlayoutMode mode_;
  TimeUs delay_us_;
  TimeUs max_ahead_us_;
  std::deque<TimedPose> poses_;
  std::deque<Arrival> arrivals_;
  TimeUs offset_us_ = 0;      ///< Least arrival minus media time, smoothed.
  TimeUs auto_delay_us_ = 0;  ///< One interval plus jitter, smoothed.
};

}  // namespace eigencast
