// SPDX-License-Identifier: MIT
#include "common/core/clock.h"

#include <gtest/gtest.h>
#include <sched.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <array>
#include <cstdint>
#include <thread>

namespace eigencast {
namespace {

/// The slice of the calling thread in nanoseconds; 0 where the kernel does not say (before Linux 6.12).
std::uint64_t slice_ns() {
  std::array<std::uint64_t, 6> attributes{};  // size and policy, flags, nice and priority, runtime, deadline, period.
  const long answer = syscall(SYS_sched_getattr, 0L, attributes.data(), sizeof attributes, 0L);
  return answer == 0 ? attributes[3] : 0;
}

template <typename Work>
void in_a_thread_of_its_own(Work work) {
  std::thread(work).join();
}

TEST(Timers, SleepsOnTimeHaveNoSlack) {
  in_a_thread_of_its_own([] {
    sleep_on_time();
    EXPECT_EQ(prctl(PR_GET_TIMERSLACK, 0, 0, 0, 0), 1);
  });
}

TEST(Timers, RunWhenWokenKeepsPolicyAndPriority) {
  in_a_thread_of_its_own([] {
    const int thread = static_cast<int>(syscall(SYS_gettid));
    ASSERT_EQ(setpriority(PRIO_PROCESS, static_cast<id_t>(thread), 7), 0);
    const int policy = sched_getscheduler(0);
    run_when_woken(kPassingOn);
    EXPECT_EQ(sched_getscheduler(0), policy);
    EXPECT_EQ(getpriority(PRIO_PROCESS, static_cast<id_t>(thread)), 7);
  });
}

TEST(Timers, RunWhenWokenSetsTheSlice) {
  if (slice_ns() == 0) GTEST_SKIP() << "this kernel knows no slices of threads";
  in_a_thread_of_its_own([] {
    run_when_woken(kPassingOn);
    if (slice_ns() != 100'000) GTEST_SKIP() << "this machine lets no thread choose its slice (a sandbox?)";
    run_when_woken(kMakingPoses);
    EXPECT_EQ(slice_ns(), 700'000U);
  });
}

TEST(Timers, OtherPoliciesAreKept) {
  in_a_thread_of_its_own([] {
    const sched_param none{};
    ASSERT_EQ(sched_setscheduler(0, SCHED_BATCH, &none), 0);
    const std::uint64_t before = slice_ns();
    run_when_woken(kPassingOn);
    EXPECT_EQ(sched_getscheduler(0), SCHED_BATCH);
    EXPECT_EQ(slice_ns(), before);
  });
}

}  // namespace
}  // namespace eigencast
