// SPDX-License-Identifier: MIT
#include "common/motion/interpolation.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace eigencast {
namespace {

// Differences as doubles: two int64 times of hostile origin may lie further apart than an int64 holds.
double span_us(TimeUs from, TimeUs to) {
  return static_cast<double>(to) - static_cast<double>(from);
}

}  // namespace

std::vector<double> interpolate(std::span<const double> a, std::span<const double> b, double u) {
  assert(a.size() == b.size());
  assert(u >= 0 && u <= 1);
  std::vector<double> result(a.size());
  for (std::size_t i = 0; i < a.size(); ++i) result[i] = a[i] + u * (b[i] - a[i]);
  return result;
}

TimedPose interpolate(const TimedPose& a, const TimedPose& b, TimeUs t) {
  assert(a.time_us < b.time_us);
  if (t <= a.time_us) return a;
  if (t >= b.time_us) return b;
  const double u = std::clamp(span_us(a.time_us, t) / span_us(a.time_us, b.time_us), 0.0, 1.0);
  return {t, interpolate(a.coefficients, b.coefficients, u)};
}

std::vector<double> estimate(std::span<const double> older, std::span<const double> newer, double step) {
  assert(older.size() == newer.size());
  assert(step >= 0);
  std::vector<double> result(newer.size());
  for (std::size_t i = 0; i < newer.size(); ++i) result[i] = newer[i] + step * (newer[i] - older[i]);
  return result;
}

TimedPose estimate(const TimedPose& older, const TimedPose& newer, TimeUs t, TimeUs max_ahead_us) {
  assert(older.time_us < newer.time_us);
  assert(t >= newer.time_us);
  assert(max_ahead_us >= 0);
  const double ahead_us = std::min(span_us(newer.time_us, t), static_cast<double>(max_ahead_us));
  const double step = ahead_us / span_us(older.time_us, newer.time_us);
  return {newer.time_us + static_cast<TimeUs>(std::llround(ahead_us)),
          estimate(older.coefficients, newer.coefficients, step)};
}

}  // namespace eigencast
