// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <string_view>

#include "common/core/clock.h"
#include "sender/interrupt.h"

namespace eigencast {

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

}  // namespace eigencast
