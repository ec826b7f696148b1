// SPDX-License-Identifier: MIT
#include "tools/latency/clock_track.h"

#include <algorithm>

namespace eigencast::latency {

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

}  // namespace eigencast::latency
