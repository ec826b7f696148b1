// SPDX-License-Identifier: MIT
#include "common/net/clock_offset.h"

#include <algorithm>

namespace eigencast {

namespace {
/// At four pings a second this is eight seconds, in which ordinary clocks drift apart by less than half a millisecond.
constexpr std::size_t kWindow = 32;
}  // namespace

void ClockOffset::add(TimeUs sent_us, TimeUs peer_us, TimeUs received_us) {
  if (received_us < sent_us) return;
  const TimeUs rtt = received_us - sent_us;
  samples_.push_back({peer_us - (sent_us + rtt / 2), (rtt + 1) / 2, rtt});
  if (samples_.size() > kWindow) samples_.pop_front();
}

std::optional<ClockOffset::Estimate> ClockOffset::estimate() const {
  if (samples_.empty()) return std::nullopt;
  return *std::min_element(samples_.begin(), samples_.end(),
                           [](const Estimate& a, const Estimate& b) { return a.rtt_us < b.rtt_us; });
}

}  // namespace eigencast
