// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <cstddef>
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
    TimeUs rtt_us = 0;     ///< The used sample's.
  };
  /// sent and received on our clock, peer on the peer's. A sample with received < sent is ignored.
  void add(TimeUs sent_us, TimeUs peer_us, TimeUs received_us) {
    if (received_us < sent_us) return;
    const TimeUs rtt = received_us - sent_us;
    samples_.push_back({peer_us - (sent_us + rtt / 2), (rtt + 1) / 2, rtt});
    if (samples_.size() > kWindow) samples_.pop_front();
  }
  std::optional<Estimate> estimate() const {
    if (samples_.empty()) return std::nullopt;
    const auto is_faster = [](const Estimate& a, const Estimate& b) { return a.rtt_us < b.rtt_us; };
    return *std::min_element(samples_.begin(), samples_.end(), is_faster);
  }
  void reset() { samples_.clear(); }

 private:
  /// At four pings a second this is eight seconds, in which ordinary clocks drift apart by less than 0.5 ms.
  static constexpr std::size_t kWindow = 32;

  std::deque<Estimate> samples_;
};

}  // namespace eigencast
