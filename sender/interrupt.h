// SPDX-License-Identifier: MIT
#pragma once

#include "common/core/clock.h"

namespace eigencast {

/// Turns SIGINT and SIGTERM into something to ask for. Make it before any thread is started: it blocks both signals for
/// the calling thread and all that come from it. Poses are sent when it has waited, so that these threads sleep on time
/// as well. Use from that thread.
class Interrupt {
 public:
  Interrupt();
  /// Waits until `deadline_us` on the steady clock; true if a signal came, now or before.
  bool wait_until(TimeUs deadline_us);
  /// As wait_until in the past: does not wait.
  bool requested() { return wait_until(0); }

 private:
  bool requested_ = false;
};

}  // namespace eigencast
