// SPDX-License-Identifier: MIT
#pragma once

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
/// are on ours; the offset between them is learnt from arrivals.
///
/// Time comes in as arguments. Holds at most kMaxPoses poses; the oldest goes first. Not thread-safe.
class Playout {
 public:
  static constexpr std::size_t kMaxPoses = 64;

  explicit Playout(PlayoutMode mode, TimeUs delay_us = 0, TimeUs max_ahead_us = 100'000);

  void set_mode(PlayoutMode mode) { mode_ = mode; }
  PlayoutMode mode() const { return mode_; }

  /// A pose came at `arrival_us`. One whose time is not after the newest is dropped (returns false).
  bool add(TimedPose pose, TimeUs arrival_us);

  /// The pose to show at `now_us`; nothing before the first one came.
  std::optional<TimedPose> at(TimeUs now_us) const;

  /// Forgets all poses, as at a new epoch.
  void reset();

 private:
  PlayoutMode mode_;
  TimeUs delay_us_;
  TimeUs max_ahead_us_;
  std::deque<TimedPose> poses_;
  TimeUs offset_us_ = 0;  ///< Smoothed arrival minus media time.
};

}  // namespace eigencast
