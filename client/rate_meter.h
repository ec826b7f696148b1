// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <deque>
#include <utility>

#include "common/core/clock.h"

namespace eigencast {

/// How fast a counter grows, over the last two seconds. Samples closer than 50 ms are merged, so it holds at most
/// about 40.
///
/// Time comes in as an argument. Not thread-safe.
class RateMeter {
 public:
  /// The counter stands at `total` now. A total that shrinks, as after a new session, starts afresh.
  void sample(std::uint64_t total, TimeUs now_us);
  /// Growth a second; 0 before 200 ms have been seen.
  double per_second() const;

 private:
  std::deque<std::pair<TimeUs, std::uint64_t>> samples_;
};

}  // namespace eigencast
