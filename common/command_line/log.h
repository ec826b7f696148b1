// SPDX-License-Identifier: MIT
#pragma once

#include <chrono>
#include <memory>

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

LogSink sink_to(std::shared_ptr<spdlog::logger> logger);

}  // namespace eigencast
