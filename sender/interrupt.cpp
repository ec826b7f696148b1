// SPDX-License-Identifier: MIT
#include "sender/interrupt.h"

#include <signal.h>

#include <algorithm>
#include <cerrno>

#include "common/core/clock.h"

namespace eigencast {
namespace {

sigset_t our_signals() {
  sigset_t set;
  sigemptyset(&set);
  sigaddset(&set, SIGINT);
  sigaddset(&set, SIGTERM);
  return set;
}

}  // namespace

Interrupt::Interrupt() {
  const sigset_t set = our_signals();
  // A shell's background job starts with SIGINT ignored, and an ignored signal is never pending.
  signal(SIGINT, SIG_DFL);
  pthread_sigmask(SIG_BLOCK, &set, nullptr);
  sleep_on_time();
  run_when_woken(kMakingPoses);
}

bool Interrupt::wait_until(TimeUs deadline_us) {
  const sigset_t set = our_signals();
  while (!requested_) {
    const TimeUs left_us = std::max<TimeUs>(0, deadline_us - steady_now_us());
    const timespec timeout{left_us / 1'000'000, (left_us % 1'000'000) * 1000};
    if (sigtimedwait(&set, nullptr, &timeout) > 0)
      requested_ = true;
    else if (errno == EAGAIN)
      break;
  }
  return requested_;
}

}  // namespace eigencast
