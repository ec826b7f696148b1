// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <string>
#include <string_view>

namespace eigencast {

/// kInfo: a user may care. kWarning: works, but somebody should check. kError: something was refused or lost.
enum class LogLevel { kDebug, kInfo, kWarning, kError };

/// Where a library's log lines go; a program binds it to its logger. Empty means silence.
/// It is called on any thread: the sink must be thread-safe.
using LogSink = std::function<void(LogLevel, std::string_view message)>;

inline void log(const LogSink& sink, LogLevel level, std::string_view message) {
  if (sink) sink(level, message);
}

}  // namespace eigencast
