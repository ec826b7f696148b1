// SPDX-License-Identifier: MIT
#pragma once

#include "common/core/clock.h"

namespace eigencast {

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

}  // namespace eigencast
