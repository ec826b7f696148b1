// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <string>
#include <string_view>

#include "common/core/clock.h"

namespace eigencast {

/// "solving eigenpairs  [#####.....]  43 %  12 s left" on standard error, rewritten in place on a terminal; elsewhere
/// nothing. Not thread-safe.
class ProgressLine {
 public:
  /// stops: whether the work is to end.
  ProgressLine(bool shown, std::function<bool()> stops) : shown_(shown), stops_(std::move(stops)) {}
  ~ProgressLine() { finish(); }

  /// False: interrupted.
  bool operator()(double fraction, std::string_view stage);
  void finish();

  /// Time left is stated from 2 % and 1 s on.
  static std::string text(double fraction, std::string_view stage, TimeUs elapsed_us);

 private:
  bool shown_;
  std::function<bool()> stops_;
  bool open_ = false;
  TimeUs start_us_ = -1;
  TimeUs shown_us_ = 0;
  std::string stage_;
};

}  // namespace eigencast
