// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <string_view>

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

/// "solving eigenpairs  [#####.....]  43 %  12 s left", rewritten in place on a terminal; elsewhere nothing.
class ProgressLine {
 public:
  ProgressLine(bool shown, Interrupt& interrupt) : shown_(shown), interrupt_(interrupt) {}
  ~ProgressLine() { finish(); }

  /// False: interrupted.
  bool operator()(double fraction, std::string_view stage);
  void finish();

  /// Time left is stated from 2 % and 1 s on.
  static std::string text(double fraction, std::string_view stage, TimeUs elapsed_us);

 private:
  bool shown_;
  Interrupt& interrupt_;
  bool open_ = false;
  TimeUs start_us_ = -1;
  TimeUs shown_us_ = 0;
  std::string stage_;
};

/// Logs the error and gives its exit status; an interrupted run says only that.
int report_failure(const Error& error);

/// Writes all or nothing; "-": to standard output. An empty path does nothing.
Result<void> write_report(const std::string& path, const std::string& text);
/// Gives the exit status; an error is logged.
int end_with_report(const std::string& path, const std::string& text);

}  // namespace eigencast
