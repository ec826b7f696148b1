// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <utility>

#include "common/core/clock.h"

namespace eigencast {

/// Adds up the work on a picture between start() and stop(), without waiting for poses or the display.
class WorkClock final {
 public:
  void start(TimeUs now_us) { began_us_ = now_us; }
  void stop(TimeUs now_us) {
    if (began_us_) spent_us_ += now_us - *began_us_;
    began_us_.reset();
  }
  /// Returns the sum and begins the next picture.
  TimeUs take() { return std::exchange(spent_us_, 0); }

 private:
  std::optional<TimeUs> began_us_;
  TimeUs spent_us_ = 0;
};

}  // namespace eigencast
