// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "common/command_line/progress.h"
#include "common/core/clock.h"
#include "common/core/result.h"

namespace eigencast {

enum ExitCode {
  kExitOk = 0,
  kExitFailed = 1,
  kExitUsage = 2,
  kExitUnreachable = 4,  ///< The broker was not reached, or said no.
};

struct Console {
  bool progress = false;  ///< Show progress on standard error.
};

/// Turns SIGINT and SIGTERM into something to ask for. Make it before any thread is started: it blocks both signals for
/// the calling thread and its children, and lets them sleep on time. Use from that thread.
class Interrupt {
 public:
  Interrupt();
  /// True if a signal came, now or before.
  bool wait_until(TimeUs deadline_us);
  bool requested() { return wait_until(0); }

 private:
  bool requested_ = false;
};

/// For a ProgressLine.
inline auto stops_at(Interrupt& interrupt) {
  return [&interrupt] { return interrupt.requested(); };
}

/// Logs the error and gives its exit status; an interrupted run says only that.
int report_failure(const Error& error);

/// Writes all or nothing; "-": to standard output. An empty path does nothing.
Result<void> write_report(const std::string& path, const std::string& text);
/// Gives the exit status; an error is logged.
int end_with_report(const std::string& path, const std::string& text);

}  // namespace eigencast
