// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "common/core/clock.h"

namespace eigencast {

/// Estimates peer clock minus own clock from ping-pong exchanges: the sample of least round trip in a sliding window,
/// whose error is at most half that round trip (Cristian 1989, "Probabilistic Clock Synchronization"). Time comes in as
/// arguments. Not thread-safe.
class ClockOffset {
 public:
  struct Estimate {
    TimeUs offset_us = 0;  ///< peer_time = own_time + offset
    TimeUs error_us = 0;   ///< Bound: half the round trip of the sample used.
    TimeUs rtt_us = 0;     ///< Of the sample used.
  };
  /// sent and received on our clock, peer on the peer's. A sample with received < sent is ignored.
  void add(TimeUs sent_us, TimeUs peer_us, TimeUs received_us);
  std::optional<Estimate> estimate() const;
  void reset() { samples_.clear(); }

 private:
  std::deque<Estimate> samples_;
};

}  // namespace eigencast
