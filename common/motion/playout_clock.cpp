// SPDX-License-Identifier: MIT
#include "common/motion/playout_clock.h"

#include <algorithm>
#include <cassert>
#include <cstdlib>
#include <vector>

namespace eigencast {
namespace {

TimeUs quantile(std::vector<TimeUs>& values, double share) {
  const auto rank = static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), values.begin() + rank, values.end());
  return values[static_cast<std::size_t>(rank)];
}

}  // namespace

void PlayoutClock::add(TimeUs media_us, TimeUs arrival_us) {
  const TimeUs offset_us = arrival_us - media_us;
  if (!arrivals_.empty() && std::abs(offset_us - min_offset_us_) > kStrayUs) reset();
  const TimeUs span_us = arrivals_.empty() ? 0 : media_us - newest_media_us_;
  newest_media_us_ = media_us;
  arrivals_.push_back({arrival_us, offset_us, span_us > kLongestSpanUs ? 0 : span_us});
  while (arrivals_.size() > kMaxArrivals || arrivals_.front().arrival_us < arrival_us - kWindowUs)
    arrivals_.pop_front();
  // After one pose there is no motion that a jump could disturb, and no interval to hold it for.
  if (arrivals_.size() == 2) reading_.reset();

  std::vector<TimeUs> offsets, spans;
  for (const Arrival& a : arrivals_) {
    offsets.push_back(a.offset_us);
    if (a.span_us > 0) spans.push_back(a.span_us);
  }
  min_offset_us_ = *std::min_element(offsets.begin(), offsets.end());
  if (spans.empty()) return;
  const TimeUs span = quantile(spans, 0.5);
  longest_delay_us_ = span + *std::max_element(offsets.begin(), offsets.end()) - min_offset_us_;
  full_delay_us_ = span + quantile(offsets, 0.95) - min_offset_us_;
}

TimeUs PlayoutClock::advance(TimeUs now_us, TimeUs delay_us, std::optional<TimeUs> lag_us) {
  assert(!arrivals_.empty());
  const TimeUs goal_us = now_us - lag_us.value_or(min_offset_us_ + delay_us);
  jumped_ = !reading_ || std::abs(goal_us - reading_->media_us - (now_us - reading_->now_us)) > kStrayUs;
  if (jumped_) {
    reading_ = Reading{now_us, goal_us};
    return goal_us;
  }
  const TimeUs passed_us = std::max<TimeUs>(0, now_us - reading_->now_us);
  const TimeUs max_slew_us = passed_us / kSlew;
  const TimeUs media_us =
      std::clamp(goal_us, reading_->media_us + passed_us - max_slew_us, reading_->media_us + passed_us + max_slew_us);
  reading_ = Reading{std::max(now_us, reading_->now_us), media_us};
  return media_us;
}

}  // namespace eigencast
