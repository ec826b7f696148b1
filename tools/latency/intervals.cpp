// SPDX-License-Identifier: MIT
#include "tools/latency/intervals.h"

#include <utility>

namespace eigencast::latency {

Interval& Intervals::at(TimeUs time_us) {
  const auto is_there = [&] { return !all_.empty() && time_us < all_.back().start_us + length_us_; };
  while (!is_there() && all_.size() >= kMax) widen();
  if (!is_there()) all_.push_back({time_us / length_us_ * length_us_, length_us_, {}, {}});
  return all_.back();
}

void Intervals::widen() {
  length_us_ *= 2;
  std::vector<Interval> wide;
  for (Interval& interval : all_) {
    const TimeUs start_us = interval.start_us / length_us_ * length_us_;
    if (!wide.empty() && wide.back().start_us == start_us) {
      wide.back().keys.merge(interval.keys);
      wide.back().synthetic.merge(interval.synthetic);
    } else {
      wide.push_back({start_us, length_us_, std::move(interval.keys), std::move(interval.synthetic)});
    }
  }
  all_ = std::move(wide);
}

}  // namespace eigencast::latency
