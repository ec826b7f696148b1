// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <span>
#include <vector>

#include "common/core/bands.h"
#include "common/core/clock.h"
#include "common/motion/correction.h"
#include "common/motion/playout_clock.h"

namespace eigencast {

/// How a viewer turns poses that come at their own times into a pose for each display time.
enum class PlayoutMode : std::uint8_t {
  kLatest,       ///< Show the newest pose as it is: no added delay, motion as even as the arrivals.
  kInterpolate,  ///< Show what lies between poses; hold the newest where the next one is late.
  kEstimate,     ///< The same, but run on beyond the newest pose, damped, for a stated time.
};

struct PlayoutSettings {
  PlayoutMode mode = PlayoutMode::kLatest;
  /// From 0, live: nothing is held, to 1, smooth: poses are held for an interval and the jitter, so that the next one
  /// is nearly always there. Default: 1 of kInterpolate, 0 of kEstimate.
  std::optional<double> smoothness;
  TimeUs delay_us = 0;            ///< Hold poses for just so long instead; 0: as smoothness says.
  TimeUs max_ahead_us = 200'000;  ///< Estimates end so long after the newest pose; then it is held.
};

/// Who made a pose that came.
enum class PoseOrigin : std::uint8_t { kSender, kBetween, kEstimate };

struct PlayoutPose {
  TimeUs time_us = 0;
  std::vector<double> coefficients;  ///< r x c, row-major; what is absent as it is to be read.
  BandMask bands = 0xff;             ///< Those that it has.
  PoseOrigin origin = PoseOrigin::kSender;
};

/// What a picture shows: a pose as it came, one between two, one beyond the newest, or the last one for want of
/// another.
enum class Shown : std::uint8_t { kLive, kInterpolated, kEstimated, kHeld };

struct ShownPose {
  TimeUs time_us = 0;  ///< The media time that it shows.
  std::vector<double> coefficients;
  BandMask bands = 0xff;
  Shown shown = Shown::kLive;
  bool settling = false;  ///< An error shown before is fading: the same pose looks different the next time.
};

/// Jitter buffer and player of one stream. Media times are capture times on the sender's clock, display times are on
/// ours; PlayoutClock relates them.
///
///   between poses   on the parabola through the two and their neighbours (curve.h); straight where those are missing,
///                   have other bands, or lie across a pause. Only bands that both poses have are mixed.
///   beyond          newest + (steps damped by kDamping) (newest - the one before), in the bands that both have
///   corrections     where a pose that comes says that what is shown is wrong (it was estimated, or held), the error
///                   fades as Correction says. Estimates that came from the broker yield to the first pose that is
///                   none.
///   old poses       those that are not after the newest are dropped; of the others at most kMaxPoses are kept
///
/// Time comes in as arguments. Not thread-safe.
class Playout {
 public:
  static constexpr std::size_t kMaxPoses = 64;
  static constexpr double kDamping = 27.0 / 32;    ///< That of the protocol's damped estimates.
  static constexpr TimeUs kHeldAfterUs = 250'000;  ///< kLatest: nothing came for so long.

  explicit Playout(const PlayoutSettings& settings = {});

  /// What is shown goes over to the new settings as to a correction.
  void set(const PlayoutSettings& settings);
  const PlayoutSettings& settings() const { return settings_; }
  double smoothness() const;

  /// The rows at which the bands of poses end; empty: not known, all is mixed.
  void set_band_ends(std::span<const std::uint32_t> ends) { band_ends_.assign(ends.begin(), ends.end()); }

  /// A pose came at `arrival_us`. One whose time is not after the newest is dropped (returns false). A pose of another
  /// size than those before it replaces them all.
  bool add(PlayoutPose pose, TimeUs arrival_us);

  /// The pose to show at `now_us`, which does not go back; nothing before the first one came.
  std::optional<ShownPose> at(TimeUs now_us);

  /// How long poses are held on purpose.
  TimeUs delay_us() const;

  /// Forgets all poses, as at a new epoch.
  void reset();

 private:
  struct Term {
    const PlayoutPose* pose;
    double weight;
  };
  void drop_estimates();
  ShownPose planned(TimeUs media_us) const;
  ShownPose between(std::size_t to, TimeUs media_us) const;
  ShownPose beyond_newest(TimeUs media_us) const;
  ShownPose mixed(std::span<const Term> terms, BandMask bands, const PlayoutPose& a, const PlayoutPose& b) const;
  TimeUs media_time(TimeUs now_us);
  void correct(const ShownPose& right, TimeUs now_us);

  PlayoutSettings settings_;
  std::vector<std::uint32_t> band_ends_;
  PlayoutClock clock_;
  Correction correction_;
  std::deque<PlayoutPose> poses_;
  TimeUs newest_arrival_us_ = 0;
  TimeUs newest_sure_us_ = 0;          ///< Media time of the newest pose that is no estimate.
  std::optional<TimeUs> latest_us_;    ///< kLatest: the newest media time shown.
  std::optional<TimeUs> shown_at_us_;  ///< Media time of what was shown last.
  ShownPose shown_;                    ///< That, without the correction.
  bool poses_changed_ = false, settings_changed_ = false;
};

}  // namespace eigencast
