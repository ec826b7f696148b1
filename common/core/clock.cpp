// SPDX-License-Identifier: MIT
#include "common/core/clock.h"

#include <chrono>

namespace eigencast {

TimeUs steady_now_us() {
  // libstdc++'s steady_clock is CLOCK_MONOTONIC, whose zero all processes of a machine share.
  return std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

TimeUs SteadyClock::now_us() const {
  return steady_now_us();
}

}  // namespace eigencast
