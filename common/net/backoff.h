// SPDX-License-Identifier: MIT
#pragma once

#include <chrono>

namespace eigencast {

/// How long to wait before try number `failures` (1 after the first failure): first * 2^(failures - 1), at most
/// `longest`, times 0.75 .. 1.25 as `unit` goes from 0 to 1. The jitter keeps many clients from coming back in step.
/// REQUIRES: failures >= 1, 0 <= unit <= 1, first > 0
std::chrono::milliseconds retry_delay(int failures, std::chrono::milliseconds first, std::chrono::milliseconds longest,
                                      double unit);

}  // namespace eigencast
