// SPDX-License-Identifier: MIT
#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string_view>
#include <utility>

#include "common/core/clock.h"
#include "common/core/log.h"

namespace spdlog {
class logger;
}

namespace eigencast {

enum class LogFormat {
  kTerminal,  ///< Time of day; colours on a terminal, unless NO_COLOR is set and not empty.
  kText,      ///< Date and time.
  kJson,      ///< An object a line; messages must be JSON values.
};

/// The log of a program, on standard error. Control characters of messages, which peers may have written, are escaped.
/// Thread-safe.
///   min_level  messages below are left out
std::shared_ptr<spdlog::logger> stderr_logger(LogLevel min_level, LogFormat format = LogFormat::kTerminal);

/// A line of `ago`.
void write_line(spdlog::logger& logger, LogLevel level, std::string_view message, std::chrono::microseconds ago = {});

/// Decides which lines pass, so that no peer fills a disk: 50 of a kind in 10 seconds. Not thread-safe.
class LogThrottle {
 public:
  /// How many of its kind were left out since the last that passed; nothing: so is this one.
  std::optional<std::uint64_t> pass(const LogLine& line, TimeUs now_us);

 private:
  struct Kind {
    TimeUs end_us = 0;
    int passed = 0;
    std::uint64_t omitted = 0;
  };
  std::map<std::pair<std::string_view, int>, Kind> kinds_;  ///< As many as the source has.
};

/// Through a LogThrottle.
LogSink sink_to(std::shared_ptr<spdlog::logger> logger);

}  // namespace eigencast
