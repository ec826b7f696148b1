// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>

#include "common/core/clock.h"

namespace eigencast::broker {

/// Decides whether poses for connections that watch several streams wait for the next tick, so that one write carries
/// the poses of all streams. They wait under load only. The load measure, poses due to such connections, does not
/// depend on the decision, so that it does not oscillate. Not thread-safe.
class Gathering {
 public:
  struct Settings {
    TimeUs tick_us = 8'000;                   ///< Longest delay; the mean is half of it. 0: never gather.
    std::uint64_t above_per_second = 20'000;  ///< Poses; gathering ends below half of it.
  };

  explicit Gathering(const Settings& settings) : settings_(settings) {}

  /// `poses` are due to a connection of several streams. True: they may wait.
  bool waits(std::uint64_t poses, TimeUs now_us);
  TimeUs next_tick_us(TimeUs now_us) const { return (now_us / settings_.tick_us + 1) * settings_.tick_us; }

 private:
  Settings settings_;
  TimeUs period_start_us_ = 0;
  std::uint64_t poses_ = 0;
  bool waits_ = false;
};

}  // namespace eigencast::broker
