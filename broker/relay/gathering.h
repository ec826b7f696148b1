// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>

#include "common/core/clock.h"

namespace eigencast::broker {

/// Decides whether poses for connections that watch several streams wait for the next tick, so that those of all its
/// streams leave a connection in one write. Only under load, and what it looks at, the poses owed to such connections,
/// does not depend on its own answer, so that it does not swing. Time comes in as an argument. Not thread-safe.
class Gathering {
 public:
  struct Settings {
    TimeUs tick_us = 8'000;                   ///< Longest delay; half of it in the mean. 0: never gather.
    std::uint64_t above_per_second = 20'000;  ///< Poses; it ends below half of it.
  };

  explicit Gathering(const Settings& settings) : settings_(settings) {}

  /// `poses` are owed now to a connection of several streams. True: they may wait.
  bool waits(std::uint64_t poses, TimeUs now_us);
  /// The tick that follows `now_us`.
  TimeUs next_tick_us(TimeUs now_us) const { return (now_us / settings_.tick_us + 1) * settings_.tick_us; }

 private:
  Settings settings_;
  TimeUs period_start_us_ = 0;
  std::uint64_t poses_ = 0;
  bool waits_ = false;
};

}  // namespace eigencast::broker
