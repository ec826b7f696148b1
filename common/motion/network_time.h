// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <cstddef>

#include "common/core/clock.h"

namespace eigencast {

/// A time from the network, held within 2,000 years, so that no sum of a few times overflows.
inline TimeUs bounded_time(TimeUs time_us) {
  constexpr TimeUs kMaxTime = TimeUs{1} << 56;
  return std::clamp(time_us, -kMaxTime, kMaxTime);
}

/// Arrivals of keys that are remembered, however fast they come.
inline constexpr std::size_t kMaxArrivals = 512;

}  // namespace eigencast
