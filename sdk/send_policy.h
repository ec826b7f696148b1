// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>

#include "common/codec/key.h"
#include "common/core/clock.h"

/// What a publisher sends, how finely, and what it leaves out. Pure: time and bytes come in as arguments.
namespace eigencast {

/// Moves the spacing of levels, and where that is not enough the number of bands, so that a stream keeps to a bit rate:
/// the spacing within about a second; bands come back one by one, and one that had to go again ever later.
class RateControl {
 public:
  struct Choice {
    std::uint8_t half_spacing = 0;
    std::uint8_t bands = 0;  ///< How many, from the lowest.
    bool operator==(const Choice&) const = default;
  };

  /// target_bits_per_s  envelope and all;  finest  half spacing that the error bound asks for: never finer
  RateControl(double target_bits_per_s, std::uint8_t finest, std::uint8_t bands);

  Choice choice() const { return choice_; }
  void add(std::size_t bytes, TimeUs capture_us);  ///< A frame left; times grow.

 private:
  double target_;
  std::uint8_t finest_, all_bands_;
  double log_spacing_;  ///< log2 of the half spacing.
  double bits_per_s_;   ///< Averages the last half second or so.
  std::optional<TimeUs> last_us_;
  TimeUs bands_changed_us_ = 0;
  TimeUs band_pause_us_;        ///< Before a band comes back.
  bool band_on_trial_ = false;  ///< The last change was that one came back.
  Choice choice_;
};

/// Values of the others are 0. REQUIRES: it is of `layout`.
Key lowest_bands(const CoefficientLayout& layout, Key key, std::uint8_t count);

/// Sends the poses of a surface only while it moves. Every viewer stays within the bound: the first still pose is sent
/// as the held one again, so that nobody goes on along the old motion; when it moves again, the held pose is sent once
/// more, stamped with the last time at which it held, so that nobody interpolates through the pause.
class StillGate {
 public:
  enum class Action {
    kSend,    ///< The pose itself.
    kHold,    ///< The held pose, at this pose's time.
    kSkip,    ///< Nothing.
    kResume,  ///< The held pose at held_until_us(), then the pose itself.
  };

  /// bound  surface distance up to which a pose counts as the held one;  heartbeat_us  of still surfaces, > 0
  StillGate(double bound, TimeUs heartbeat_us) : bound_(bound), heartbeat_us_(heartbeat_us) {}

  /// distance  of the pose from what receivers hold. The caller does what is returned.
  Action next(double distance, TimeUs capture_us);
  TimeUs held_until_us() const { return held_until_us_; }
  void restart() { state_ = State::kMoving; }  ///< The chain begins anew: the next pose is sent.

 private:
  enum class State { kMoving, kStill };
  double bound_;
  TimeUs heartbeat_us_;
  State state_ = State::kMoving;
  TimeUs sent_us_ = 0;        ///< When the last held pose was sent.
  TimeUs held_until_us_ = 0;  ///< Time of the last pose that was skipped, or sent as held.
};

}  // namespace eigencast
