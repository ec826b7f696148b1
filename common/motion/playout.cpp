// SPDX-License-Identifier: MIT
#include "common/motion/playout.h"

#include <algorithm>
#include <cassert>
#include <cstdlib>
#include <utility>
#include <vector>

namespace eigencast {
namespace {

constexpr std::size_t kMaxArrivals = 512;
constexpr TimeUs kLongestSpanUs = 500'000;  // A pause is not an interval to wait for.

// Media times come from the network: held far enough from the ends that no sum of a few of them overflows.
TimeUs bounded(TimeUs time_us) {
  constexpr TimeUs kBound = TimeUs{1} << 60;
  return std::clamp(time_us, -kBound, kBound);
}

TimeUs moved_towards(TimeUs from, TimeUs to, TimeUs at_most) {
  return from + std::clamp(to - from, -at_most, at_most);
}

// The value that `share` of `values` are not above.
TimeUs quantile(std::vector<TimeUs>& values, double share) {
  const auto rank = static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), values.begin() + rank, values.end());
  return values[static_cast<std::size_t>(rank)];
}

}  // namespace

Playout::Playout(PlayoutMode mode, TimeUs delay_us, TimeUs max_ahead_us)
    : mode_(mode), delay_us_(delay_us), max_ahead_us_(max_ahead_us) {
  assert(delay_us >= 0 && max_ahead_us >= 0);
}

void Playout::reset() {
  poses_.clear();
  arrivals_.clear();
  offset_us_ = auto_delay_us_ = 0;
}

bool Playout::add(TimedPose pose, TimeUs arrival_us) {
  pose.time_us = bounded(pose.time_us);
  if (!poses_.empty() && pose.time_us <= poses_.back().time_us) return false;
  follow(pose.time_us, bounded(arrival_us));
  if (!poses_.empty() && pose.coefficients.size() != poses_.back().coefficients.size()) poses_.clear();
  poses_.push_back(std::move(pose));
  if (poses_.size() > kMaxPoses) poses_.pop_front();
  return true;
}

void Playout::follow(TimeUs media_us, TimeUs arrival_us) {
  const TimeUs offset_us = arrival_us - media_us;
  if (!arrivals_.empty() && std::abs(offset_us - offset_us_) > kStrayUs) arrivals_.clear();
  if (arrivals_.empty()) {
    arrivals_.push_back({arrival_us, offset_us, 0});
    offset_us_ = offset_us;
    auto_delay_us_ = 0;
    return;
  }
  const TimeUs passed_us = std::max<TimeUs>(0, arrival_us - arrivals_.back().arrival_us);
  const TimeUs span_us = poses_.empty() ? 0 : media_us - poses_.back().time_us;
  arrivals_.push_back({arrival_us, offset_us, span_us > kLongestSpanUs ? 0 : span_us});
  while (arrivals_.size() > kMaxArrivals || arrivals_.front().arrival_us < arrival_us - kWindowUs)
    arrivals_.pop_front();

  std::vector<TimeUs> offsets, spans;
  for (const Arrival& a : arrivals_) {
    offsets.push_back(a.offset_us);
    if (a.span_us > 0) spans.push_back(a.span_us);
  }
  const TimeUs least_us = *std::min_element(offsets.begin(), offsets.end());
  // Half of the allowed correction for each of the two, so that their sum keeps to it.
  const TimeUs at_most_us = passed_us / (2 * kSlew);
  offset_us_ = moved_towards(offset_us_, least_us, at_most_us);
  if (spans.empty()) return;
  const TimeUs interval_us = quantile(spans, 0.5);
  const TimeUs wanted_us = interval_us + quantile(offsets, 0.95) - least_us;
  // The first interval is taken at once: there is no motion yet that it could disturb.
  auto_delay_us_ = auto_delay_us_ == 0 ? interval_us : moved_towards(auto_delay_us_, wanted_us, at_most_us);
}

TimeUs Playout::delay_us() const {
  return delay_us_ > 0 ? delay_us_ : auto_delay_us_;
}

std::optional<TimedPose> Playout::at(TimeUs now_us) const {
  if (poses_.empty()) return std::nullopt;
  const TimedPose& newest = poses_.back();
  if (mode_ == PlayoutMode::kLatest) return newest;
  const TimeUs media_us = bounded(now_us) - offset_us_ - (mode_ == PlayoutMode::kInterpolate ? delay_us() : 0);
  if (media_us >= newest.time_us) {
    if (mode_ == PlayoutMode::kInterpolate || poses_.size() < 2) return newest;
    return estimate(poses_[poses_.size() - 2], newest, media_us, max_ahead_us_);
  }
  const auto is_before = [](TimeUs t, const TimedPose& pose) { return t < pose.time_us; };
  const auto after = std::upper_bound(poses_.begin(), poses_.end(), media_us, is_before);
  if (after == poses_.begin()) return poses_.front();
  return interpolate(*(after - 1), *after, media_us);
}

}  // namespace eigencast
