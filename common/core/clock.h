// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>

namespace eigencast {

/// Microseconds on some clock. Differences are meaningful on one clock only.
using TimeUs = std::int64_t;

/// Now on CLOCK_MONOTONIC, which never steps and is the same for all processes of one machine. Thread-safe.
TimeUs steady_now_us();

/// Since 1970 (UTC), where that clock says 0. Thread-safe.
TimeUs unix_at_steady_zero_us();

/// A time from the network, held within 2,000 years, so that no sum of a few times overflows.
inline TimeUs bounded_time(TimeUs time_us) {
  constexpr TimeUs kMaxTime = TimeUs{1} << 56;
  return std::clamp(time_us, -kMaxTime, kMaxTime);
}

/// Lets the calling thread's sleeps end when they are due, and not up to 50 us later, which is what Linux otherwise
/// takes to gather wake-ups (PR_SET_TIMERSLACK). For threads that keep a schedule. Threads that it starts inherit it.
void sleep_on_time();

/// What threads that only pass on what has just come work at a time; and what those do that make a pose.
inline constexpr std::chrono::microseconds kPassingOn{100}, kMakingPoses{700};

/// Asks the kernel to run the calling thread soon after it wakes rather than long at a time: in slices of `work`, at
/// the priority that it has (Linux 6.12 and later; elsewhere nothing changes). Where all cores are busy, a thread that
/// wakes otherwise waits until the one that runs has had its slice, up to a tick of 4 ms. Threads that it starts
/// inherit it.
///   work  about the most that it does after waking, 0.1 to 100 ms: the kernel prefers threads that ask for less
void run_when_woken(std::chrono::microseconds work);

}  // namespace eigencast
