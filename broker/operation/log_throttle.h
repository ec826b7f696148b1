// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>

#include "common/core/clock.h"

namespace eigencast::broker {

/// Decides which log lines are written, so that a flood of one kind (a client that fails a thousand times a second)
/// cannot fill the disk or hide the others: of lines that differ in digits only, a few in each period pass, and the
/// next that passes says how many did not. Remembers a bounded number of kinds. Not thread-safe.
class LogThrottle {
 public:
  struct Settings {
    std::uint32_t lines = 10;  ///< Of one kind in a period.
    TimeUs period_us = 10'000'000;
    std::size_t max_kinds = 512;  ///< Beyond them the longest silent one is forgotten.
  };
  LogThrottle() : LogThrottle(Settings{}) {}
  explicit LogThrottle(const Settings& settings) : settings_(settings) {}

  /// How many lines of this kind were left out since the last one that passed; nothing: leave this one out, too.
  std::optional<std::uint64_t> admit(std::string_view line, TimeUs now_us);

 private:
  struct Kind {
    TimeUs period_start_us = 0;
    TimeUs last_us = 0;
    std::uint32_t passed = 0;
    std::uint64_t left_out = 0;
  };
  Settings settings_;
  std::map<std::string, Kind, std::less<>> kinds_;
};

}  // namespace eigencast::broker
