// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <deque>
#include <utility>

#include "common/core/clock.h"

namespace eigencast {

/// The growth of a counter over the last two seconds; merges samples closer than 50 ms. Not thread-safe.
class RateMeter {
 public:
  /// A total that shrinks, as of a new session, starts afresh.
  void sample(std::uint64_t total, TimeUs now_us);
  /// Growth a second; 0 before 200 ms have been seen.
  double per_second() const;

 private:
  std::deque<std::pair<TimeUs, std::uint64_t>> samples_;
};

}  // namespace eigencast
