// SPDX-License-Identifier: MIT
#include "common/core/timers.h"

#include <sys/prctl.h>

namespace eigencast {

void sleep_on_time() {
  constexpr unsigned long kNanosecond = 1;
  (void)prctl(PR_SET_TIMERSLACK, kNanosecond, 0, 0, 0);  // A kernel that refuses sleeps as long as it did.
}

}  // namespace eigencast
