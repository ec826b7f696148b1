// SPDX-License-Identifier: MIT
#include "tools/latency/display_age.h"

#include <algorithm>

namespace eigencast::latency {
namespace {

constexpr TimeUs kSampleEveryUs = 1000;
constexpr TimeUs kLongestUs = 60'000'000;  ///< A pose that stays for longer counts for so long.

}  // namespace

void DisplayAge::show(TimeUs capture_us, TimeUs shown_us) {
  if (shown_) {
    const TimeUs until_us = std::min(shown_us, shown_->since_us + kLongestUs);
    // Samples are at multiples of the period, so that none counts for two poses.
    for (TimeUs at = (shown_->since_us / kSampleEveryUs + 1) * kSampleEveryUs; at <= until_us; at += kSampleEveryUs)
      ages_us_.add(at - shown_->capture_us);
  }
  shown_ = Shown{capture_us, shown_us};
}

}  // namespace eigencast::latency
