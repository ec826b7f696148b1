// SPDX-License-Identifier: MIT
#include "tools/latency/over_time.h"

#include <algorithm>
#include <utility>

namespace eigencast::latency {
namespace {

constexpr TimeUs kSampleEveryUs = 1000;
constexpr TimeUs kLongestUs = 60'000'000;  ///< A pose that stays for longer counts for so long.

}  // namespace

void ClockTrack::add(const Point& point) {
  if (!points_.empty() && points_.back().offset_us == point.offset_us && points_.back().error_us == point.error_us)
    return;
  if (points_.size() == kMaxPoints) {
    for (std::size_t i = 1; 2 * i < points_.size(); ++i) points_[i] = points_[2 * i];
    points_.resize(points_.size() / 2);
  }
  points_.push_back(point);
}

std::optional<ClockTrack::Point> ClockTrack::best() const {
  if (points_.empty()) return std::nullopt;
  return *std::min_element(points_.begin(), points_.end(),
                           [](const Point& a, const Point& b) { return a.error_us < b.error_us; });
}

std::optional<ClockTrack::Drift> ClockTrack::drift() const {
  if (points_.size() < 2) return std::nullopt;
  const TimeUs first_us = points_.front().at_us;
  const double span_s = static_cast<double>(points_.back().at_us - first_us) / 1e6;
  if (span_s < 1) return std::nullopt;
  double weights = 0, t_sum = 0, o_sum = 0;
  const auto weight_of = [](const Point& p) { return 1.0 / static_cast<double>((p.error_us + 1) * (p.error_us + 1)); };
  const auto seconds = [&](const Point& p) { return static_cast<double>(p.at_us - first_us) / 1e6; };
  const auto offset = [&](const Point& p) { return static_cast<double>(p.offset_us - points_.front().offset_us); };
  for (const Point& p : points_) {
    weights += weight_of(p);
    t_sum += weight_of(p) * seconds(p);
    o_sum += weight_of(p) * offset(p);
  }
  double tt = 0, to = 0;
  for (const Point& p : points_) {
    const double t = seconds(p) - t_sum / weights;
    tt += weight_of(p) * t * t;
    to += weight_of(p) * t * (offset(p) - o_sum / weights);
  }
  if (!(tt > 0)) return std::nullopt;
  return Drift{to / tt, static_cast<double>(points_.front().error_us + points_.back().error_us) / span_s};
}

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
