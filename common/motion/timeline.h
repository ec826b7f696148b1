// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "common/core/clock.h"

namespace eigencast {

/// Plays the frames of a clip: display time in, position in the clip out. Starts at its beginning, plays at its own
/// speed, and loops. Without loop it holds the last frame, and play begins anew there. Positions are microseconds from
/// the clip's beginning. Time comes in as arguments. Not thread-safe.
class Timeline {
 public:
  static constexpr double kMinSpeed = 0.1, kMaxSpeed = 10;

  struct Moment {
    std::int64_t lap = 0;    ///< Times that the clip began again since the last seek; < 0: before it.
    TimeUs position_us = 0;  ///< In [0, period_us()); without loop at most end_us().
  };

  /// times_us: of the frames. REQUIRES: at least one, ascending from 0; all below period_us, when the first comes
  /// again.
  Timeline(std::vector<TimeUs> times_us, TimeUs period_us, TimeUs now_us);

  Moment at(TimeUs now_us) const;
  /// The newest frame that is not after the position.
  std::size_t frame_at(TimeUs position_us) const;
  /// Display time until the next frame; nothing while none is to come.
  std::optional<TimeUs> until_next_us(TimeUs now_us) const;

  const std::vector<TimeUs>& times_us() const { return times_us_; }
  TimeUs period_us() const { return period_us_; }
  TimeUs end_us() const { return times_us_.back(); }  ///< Of the last frame.
  bool paused() const { return paused_; }
  bool looping() const { return looping_; }
  double speed() const { return speed_; }
  /// Whether poses between frames are wanted; without, each frame is shown until the next one.
  bool interpolates() const { return interpolates_; }

  /// Goes on from there. A position outside the clip is moved to its nearest frame.
  void seek(TimeUs position_us, TimeUs now_us);
  /// Pauses on another frame: with loop across the ends. From between two frames one back is the earlier of them.
  void step(std::int64_t frames, TimeUs now_us);
  void set_paused(bool paused, TimeUs now_us);
  void set_looping(bool looping, TimeUs now_us);
  /// Clamped to kMinSpeed..kMaxSpeed.
  void set_speed(double speed, TimeUs now_us);
  void set_interpolates(bool interpolates) { interpolates_ = interpolates; }

 private:
  TimeUs played_us(TimeUs now_us) const;
  void go_on_from(TimeUs position_us, TimeUs now_us);

  std::vector<TimeUs> times_us_;
  TimeUs period_us_;
  TimeUs from_us_ = 0;  ///< Position at since_us_, beyond the period after laps.
  TimeUs since_us_;     ///< Display time.
  double speed_ = 1;
  bool paused_ = false, looping_ = true, interpolates_ = false;
};

/// The next of 0.1, 0.2, 0.5, 1, 2, 5, 10 in that direction; the last one stays.
double next_speed(double speed, bool faster);

}  // namespace eigencast
