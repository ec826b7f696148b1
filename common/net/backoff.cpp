// SPDX-License-Identifier: MIT
#include "common/net/backoff.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace eigencast {

std::chrono::milliseconds retry_delay(int failures, std::chrono::milliseconds first, std::chrono::milliseconds longest,
                                      double unit) {
  assert(failures >= 1 && unit >= 0 && unit <= 1 && first.count() > 0);
  const double doubled = std::ldexp(static_cast<double>(first.count()), std::min(failures - 1, 40));
  const double base = std::min(doubled, static_cast<double>(std::max(longest, first).count()));
  return std::chrono::milliseconds(std::llround(base * (0.75 + 0.5 * unit)));
}

}  // namespace eigencast
