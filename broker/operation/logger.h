// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "broker/config/config.h"
#include "common/core/clock.h"
#include "common/core/log.h"

namespace eigencast::broker {

/// Decides which lines of a log are written: a flood fills no disk and hides nothing else. Of each kind of event (a
/// place in the source) so many lines pass per period; the others are counted in one line after it. Lines wait up to a
/// number of bytes; beyond them new ones are dropped, and counted too. Not thread-safe.
class LogQueue {
 public:
  struct Settings {
    std::int64_t max_lines;  ///< Per kind and period.
    std::int64_t max_bytes;
    TimeUs period_us = 10'000'000;
  };
  struct Line {
    LogLevel level;
    std::string text;
    TimeUs time_us;
  };
  explicit LogQueue(const Settings& settings) : settings_(settings) {}

  void push(LogLevel level, const LogLine& line, TimeUs now_us);
  bool has_lines() const { return !lines_.empty(); }
  /// What is to be written now, with the counts of periods that are over, or of all if the log `ends`.
  std::vector<Line> take(TimeUs now_us, bool ends = false);

 private:
  struct Kind {
    TimeUs end_us = 0;  ///< Of the period.
    std::int64_t passed = 0;
    std::uint64_t omitted = 0;
    Line last{};  ///< Of those omitted.
  };
  Settings settings_;
  std::map<std::pair<std::string_view, int>, Kind> kinds_;  ///< As many as the source has.
  std::vector<Line> lines_;
  std::int64_t bytes_ = 0;
  std::uint64_t dropped_ = 0;
};

/// A sink that writes to standard error as [log] says: text lines, or one JSON object a line. Thread-safe. It never
/// waits: a thread of its own writes. With its last copy that thread ends, when all is written or after a second.
LogSink make_log_sink(const Config& config);

}  // namespace eigencast::broker
