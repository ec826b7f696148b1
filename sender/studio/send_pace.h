// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <optional>

#include "common/core/clock.h"

namespace eigencast::studio {

/// At once if nothing was sent for an interval, otherwise at its end, so that the last pose of a gesture is always sent;
/// and a heartbeat while nothing moves.
class SendPace {
 public:
  SendPace(TimeUs interval_us, TimeUs heartbeat_us) : interval_us_(interval_us), heartbeat_us_(heartbeat_us) {}

  void changed() { waiting_ = true; }
  /// May lie in the past.
  TimeUs due_us(TimeUs now_us) const {
    if (!sent_us_) return now_us;
    return *sent_us_ + (waiting_ ? interval_us_ : std::max(interval_us_, heartbeat_us_));
  }
  void sent(TimeUs now_us) {
    sent_us_ = now_us;
    waiting_ = false;
  }

 private:
  TimeUs interval_us_, heartbeat_us_;
  std::optional<TimeUs> sent_us_;
  bool waiting_ = false;
};

}  // namespace eigencast::studio
