// SPDX-License-Identifier: MIT
#pragma once

namespace eigencast {

/// Lets the calling thread's sleeps end when they are due, and not up to 50 us later, which is what Linux otherwise takes to
/// gather wake-ups (PR_SET_TIMERSLACK). For threads that keep a schedule. Threads that it starts inherit it.
void sleep_on_time();

}  // namespace eigencast
