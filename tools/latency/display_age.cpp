// SPDX-License-Identifier: MIT
#include "tools/latency/display_age.h"

#include <algorithm>

namespace eigencast::latency {
namespace {

constexpr TimeUs kLookEveryUs = 1000;
constexpr TimeUs kLongestUs = 60'000'000;  ///< A pose that stays for longer counts for so long.

}  // namespace

void DisplayAge::show(TimeUs capture_us, TimeUs shown_us) {
  if (shown_) {
    const TimeUs until_us = std::min(shown_us, shown_->since_us + kLongestUs);
    // Looks are at multiples of the period, so that none is counted for two poses.
    for (TimeUs at = (shown_->since_us / kLookEveryUs + 1) * kLookEveryUs; at <= until_us; at += kLookEveryUs)
      ages_us_.add(at - shown_->capture_us);
  }
  shown_ = Shown{capture_us, shown_us};
}

}  // namespace eigencast::latency
