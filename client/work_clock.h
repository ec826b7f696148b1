// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <utility>

#include "common/core/clock.h"

namespace eigencast {

/// Adds up the time that a picture takes to make: what lies between start() and stop(), however often, and nothing
/// else. Waiting for poses or for the display stays outside, and so lowers no level of detail.
class WorkClock final {
 public:
  void start(TimeUs now_us) { began_us_ = now_us; }
  /// Without a start(): nothing.
  void stop(TimeUs now_us) {
    if (began_us_) spent_us_ += now_us - *began_us_;
    began_us_.reset();
  }
  /// Of this picture; the next one begins.
  TimeUs take() { return std::exchange(spent_us_, 0); }

 private:
  std::optional<TimeUs> began_us_;
  TimeUs spent_us_ = 0;
};

}  // namespace eigencast
