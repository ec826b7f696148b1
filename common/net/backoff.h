// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <cassert>
#include <chrono>
#include <cmath>

namespace eigencast {

/// How long to wait before try number `failures` (1 after the first failure): first * 2^(failures - 1), at most
/// `longest`, times 0.75 .. 1.25 as `unit` goes from 0 to 1. The jitter keeps many clients from coming back in step.
/// REQUIRES: failures >= 1, 0 <= unit <= 1, first > 0
inline std::chrono::milliseconds retry_delay(int failures, std::chrono::milliseconds first,
                                             std::chrono::milliseconds longest, double unit) {
  assert(failures >= 1 && unit >= 0 && unit <= 1 && first.count() > 0);
  const double doubled = std::ldexp(static_cast<double>(first.count()), std::min(failures - 1, 40));
  const double base = std::min(doubled, static_cast<double>(std::max(longest, first).count()));
  return std::chrono::milliseconds(std::llround(base * (0.75 + 0.5 * unit)));
}

}  // namespace eigencast
