// SPDX-License-Identifier: MIT
#include "common/core/clock.h"

#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

namespace eigencast {
namespace {

/// What sched_getattr(2) and sched_setattr(2) take, in its first version; glibc has neither before 2.41.
struct SchedulingAttributes {
  std::uint32_t size = sizeof(SchedulingAttributes), policy = 0;
  std::uint64_t flags = 0;
  std::int32_t nice = 0;
  std::uint32_t priority = 0;
  std::uint64_t runtime_ns = 0, deadline_ns = 0, period_ns = 0;
};
static_assert(sizeof(SchedulingAttributes) == 48);

}  // namespace

TimeUs steady_now_us() {
  using std::chrono::steady_clock, std::chrono::microseconds;  // libstdc++'s steady_clock is CLOCK_MONOTONIC.
  return std::chrono::duration_cast<microseconds>(steady_clock::now().time_since_epoch()).count();
}

TimeUs unix_at_steady_zero_us() {
  using std::chrono::system_clock, std::chrono::microseconds;
  return std::chrono::duration_cast<microseconds>(system_clock::now().time_since_epoch()).count() - steady_now_us();
}

void sleep_on_time() {
  constexpr unsigned long kNanosecond = 1;
  (void)prctl(PR_SET_TIMERSLACK, kNanosecond, 0, 0, 0);  // A kernel that refuses sleeps as long as it did.
}

void run_when_woken(std::chrono::microseconds work) {
  constexpr long kThisThread = 0, kNoFlags = 0;
  constexpr std::uint32_t kOrdinary = 0;  // SCHED_OTHER; a thread of another policy keeps it.
  SchedulingAttributes attributes;
  if (syscall(SYS_sched_getattr, kThisThread, &attributes, sizeof attributes, kNoFlags) != 0) return;
  if (attributes.policy != kOrdinary) return;
  attributes.runtime_ns = static_cast<std::uint64_t>(std::chrono::nanoseconds(work).count());
  (void)syscall(SYS_sched_setattr, kThisThread, &attributes, kNoFlags);  // Refused: it waits as long as before.
}

}  // namespace eigencast
