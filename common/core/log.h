// SPDX-License-Identifier: MIT
#pragma once

#include <concepts>
#include <functional>
#include <string_view>

namespace eigencast {

/// kInfo: a user may care. kWarning: works, but somebody should check. kError: something was refused or lost.
enum class LogLevel { kDebug, kInfo, kWarning, kError };

/// A message, and the place in the source where it became one: its kind of event. Refers to the text.
struct LogLine {
  template <std::convertible_to<std::string_view> Text>
  LogLine(const Text& message, const char* in = __builtin_FILE(), int at = __builtin_LINE())
      : text(message), file(in), number(at) {}
  operator std::string_view() const { return text; }

  std::string_view text;
  std::string_view file;
  int number;
};

/// Where a library's log lines go; a program binds it to its logger. Empty means silence.
/// It is called on any thread: the sink must be thread-safe.
using LogSink = std::function<void(LogLevel, const LogLine& message)>;

inline void log(const LogSink& sink, LogLevel level, const LogLine& message) {
  if (sink) sink(level, message);
}

}  // namespace eigencast
