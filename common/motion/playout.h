// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "common/core/bands.h"
#include "common/core/clock.h"
#include "common/motion/coefficients.h"
#include "common/motion/playout_clock.h"

namespace eigencast {

/// Moves a wrongly shown pose to the right one without a jump (projective blending of dead reckoning: Murphy 2011,
/// "Believable dead reckoning for networked games"): the motion is right at once, and the error fades within kBlendUs.
/// Time comes in as arguments. Not thread-safe.
class Correction {
 public:
  static constexpr TimeUs kBlendUs = 150'000;

  /// At `now_us` the shown pose is off by `error` (shown minus right), in addition to what still fades. An error of
  /// another size replaces the old one.
  void add(std::span<const double> error, TimeUs now_us);
  /// Adds what remains of the errors at `now_us` to the right pose. Does not change a pose of another size.
  void apply(std::span<double> pose, TimeUs now_us) const;
  bool active(TimeUs now_us) const { return !error_.empty() && remaining(now_us) > 0; }
  void reset() { error_.clear(); }
  void replace(const std::function<Coefficients(const Coefficients&)>& carried);

 private:
  double remaining(TimeUs now_us) const;

  std::vector<double> error_;  ///< At since_us_.
  TimeUs since_us_ = 0;
};

enum class PlayoutMode : std::uint8_t {
  kLatest,       ///< The newest pose as it is: no added delay, motion as even as the arrivals.
  kInterpolate,  ///< Interpolate between poses; hold the newest where the next one is late.
  kEstimate,     ///< The same, but extrapolate beyond the newest pose, damped, for a limited time.
};

struct PlayoutSettings {
  PlayoutMode mode = PlayoutMode::kLatest;
  /// 0, live: nothing is held; 1, smooth: poses are held for an interval and the jitter, so that the next one has
  /// nearly always come. Default: 1 with kInterpolate, 0 with kEstimate.
  std::optional<double> smoothness;
  TimeUs delay_us = 0;            ///< Hold poses for this long instead; 0: by smoothness.
  TimeUs max_ahead_us = 200'000;  ///< How long after the newest pose estimates end and are held.
};

/// How a pose came about: sent, made between two keys, estimated beyond the newest; or held for want of another.
enum class Shown : std::uint8_t { kLive, kInterpolated, kEstimated, kHeld };

struct PlayoutPose {
  TimeUs time_us = 0;         ///< Media time.
  Coefficients coefficients;  ///< Absent bands as they are to be read.
  BandMask bands = 0xff;      ///< Those that it has.
  Shown shown = Shown::kLive;
  bool settling = false;  ///< An error shown before is fading: the same pose changes with the display time.
};

/// Jitter buffer and player of one stream. Media times are capture times on the sender's clock, display times are on
/// ours; PlayoutClock relates them.
///
///   between poses   catmull_rom_weights(); linear where a neighbour is missing, lacks bands, or lies across a pause.
///                   Only bands of both poses are mixed.
///   ahead           a key whose poses are still to come is moved towards like any other; poses come before it
///   beyond          newest + damped_steps(.., kDamping) (newest - the one before), in the bands of both
///   corrections     where a new pose shows that the shown one was wrong (estimated, or held), the error fades (see
///                   Correction). A pose that is not an estimate replaces the broker's estimates.
///   old poses       poses not after the newest are dropped; at most kMaxPoses are kept
/// Time comes in as arguments. Not thread-safe.
class Playout {
 public:
  static constexpr std::size_t kMaxPoses = 64;
  static constexpr double kDamping = 27.0 / 32;    ///< As in the protocol's damped estimates.
  static constexpr TimeUs kHeldAfterUs = 250'000;  ///< kLatest: time without a pose that counts as held.

  explicit Playout(const PlayoutSettings& settings = {});

  /// Changes the settings; the shown pose moves over as in a correction.
  void set(const PlayoutSettings& settings);
  const PlayoutSettings& settings() const { return settings_; }
  double smoothness() const;
  /// At `now` the pose of now - lag_us is shown, but with kLatest; nothing: by the settings.
  void set_lag(std::optional<TimeUs> lag_us) { lag_us_ = lag_us; }
  const std::optional<TimeUs>& lag_us() const { return lag_us_; }
  /// The least lag with which all poses of late would have been there in time. Nothing before the second pose.
  std::optional<TimeUs> needed_lag_us() const;

  /// The rows at which bands end; empty: unknown, all rows are mixed.
  void set_band_ends(std::span<const std::uint32_t> ends) { band_ends_.assign(ends.begin(), ends.end()); }

  /// Takes a pose that arrived at `arrival_us`. Drops it where it is not after the newest (returns false). All before
  /// have zeros where it is longer, as by what its stream has learnt; a shorter one replaces them.
  bool add(PlayoutPose pose, TimeUs arrival_us);
  /// Takes a key that came before the poses that lead up to it. Drops it where it is not after the newest.
  void add_next(PlayoutPose key);
  /// The pose to show at `now_us`, which does not go back; nothing before the first one came.
  std::optional<PlayoutPose> at(TimeUs now_us);
  TimeUs delay_us() const;
  /// Poses go on in another basis: each as `carried` gives it, all of one size, with all bands.
  void replace_poses(const std::function<Coefficients(const Coefficients&)>& carried);
  /// Forgets all poses, as at a new epoch.
  void reset();

 private:
  struct Term {
    const PlayoutPose* pose;
    double weight;
  };
  const PlayoutPose& newest() const { return poses_[poses_.size() - (next_ahead_ ? 2 : 1)]; }
  void drop_estimates() {
    while (!poses_.empty() && poses_.back().shown == Shown::kEstimated) poses_.pop_back();
  }
  PlayoutPose planned(TimeUs media_us) const;
  PlayoutPose between(std::size_t to, TimeUs media_us) const;
  PlayoutPose beyond_newest(TimeUs media_us) const;
  PlayoutPose mixed(std::span<const Term> terms, BandMask bands, const PlayoutPose& a, const PlayoutPose& b) const;
  TimeUs media_time(TimeUs now_us);
  void correct(const PlayoutPose& right, TimeUs now_us);

  PlayoutSettings settings_;
  std::optional<TimeUs> lag_us_;
  std::vector<std::uint32_t> band_ends_;
  PlayoutClock clock_;
  Correction correction_;
  std::deque<PlayoutPose> poses_;
  bool next_ahead_ = false;  ///< The last of several poses is a key whose poses are still to come.
  TimeUs newest_arrival_us_ = 0;
  TimeUs newest_sure_us_ = 0;          ///< Media time of the newest pose that is not an estimate.
  std::optional<TimeUs> latest_us_;    ///< kLatest: the newest media time shown.
  std::optional<TimeUs> shown_at_us_;  ///< Media time of what was shown last.
  PlayoutPose shown_;                  ///< That, without the correction.
  bool poses_changed_ = false, settings_changed_ = false;
};

}  // namespace eigencast
