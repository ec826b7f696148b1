// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>

#include "common/core/clock.h"
#include "common/core/log.h"

namespace eigencast::broker {

/// Keeps a flood of log lines of one kind from filling the disk or hiding the others: a few of each kind pass per
/// period. Lines that differ in digits only are of one kind. Not thread-safe.
class LogThrottle {
 public:
  struct Settings {
    std::uint32_t lines = 10;  ///< Per kind and period.
    TimeUs period_us = 10'000'000;
    std::size_t max_kinds = 512;  ///< Beyond them the longest silent kind is dropped.
  };
  LogThrottle() : LogThrottle(Settings{}) {}
  explicit LogThrottle(const Settings& settings) : settings_(settings) {}

  /// The number of lines of this kind omitted since the last one that passed; nothing: omit this one too.
  std::optional<std::uint64_t> admit(std::string_view line, TimeUs now_us);

 private:
  struct Kind {
    TimeUs period_start_us = 0;
    TimeUs last_us = 0;
    std::uint32_t passed = 0;
    std::uint64_t omitted = 0;
  };
  Settings settings_;
  std::map<std::string, Kind, std::less<>> kinds_;
};

/// A sink that writes to standard error: text lines, or one JSON object a line; floods are throttled. Thread-safe.
///   level   "debug", "info", "warning" or "error"
///   format  "text" or "json"
LogSink make_log_sink(const std::string& level, const std::string& format);

}  // namespace eigencast::broker
