// SPDX-License-Identifier: MIT
#include "sender/deform/script.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace eigencast::deform {
namespace {

/// Between secants s0 and s1 over spans h0 and h1: zero at an extremum, else their weighted harmonic mean.
double slope(double s0, double s1, double h0, double h1) {
  if (s0 * s1 <= 0) return 0;
  return 3 * (h0 + h1) / ((2 * h1 + h0) / s0 + (h1 + 2 * h0) / s1);
}

Vec3 moved_by(const Move& move, const Box& box, const Vec3& p, std::size_t which, std::span<const double> values) {
  switch (move.kind) {
    case Move::Kind::kTwist:
      return twisted(p, box, move.frame, values[0]);
    case Move::Kind::kBend:
      return bent(p, box, move.frame, values[0]);
    case Move::Kind::kRotate:
      return turned(p, move.centre, move.frame.axis, values[0]);
    case Move::Kind::kTranslate:
      return {p[0] + values[0], p[1] + values[1], p[2] + values[2]};
    case Move::Kind::kScale:
      return scaled(p, move.centre, {values[0], values[1], values[2]});
    case Move::Kind::kPlace:
      return {values[3 * which], values[3 * which + 1], values[3 * which + 2]};
  }
  return p;
}

}  // namespace

std::vector<double> Track::at(double time_s) const {
  assert(!times.empty() && values.size() == times.size() * width);
  const auto row = [&](std::size_t key) { return &values[key * width]; };
  const auto after = std::upper_bound(times.begin(), times.end(), time_s);
  const std::size_t last = times.size() - 1;
  if (after == times.begin()) return {row(0), row(0) + width};
  if (after == times.end()) return {row(last), row(last) + width};
  const auto b = static_cast<std::size_t>(after - times.begin()), a = b - 1;
  const double h = times[b] - times[a], u = (time_s - times[a]) / h;
  std::vector<double> result(width);
  for (std::size_t k = 0; k < width; ++k) {
    const auto secant = [&](std::size_t key) {
      return (row(key + 1)[k] - row(key)[k]) / (times[key + 1] - times[key]);
    };
    const double s = secant(a);
    const double m0 = a > 0 ? slope(secant(a - 1), s, times[a] - times[a - 1], h) : 0;
    const double m1 = b < last ? slope(s, secant(b), h, times[b + 1] - times[b]) : 0;
    const double v = 1 - u;
    result[k] = v * v * (1 + 2 * u) * row(a)[k] + u * u * (3 - 2 * u) * row(b)[k] + h * u * v * (v * m0 - u * m1);
  }
  return result;
}

std::vector<Vec3> Script::handles_at(double time_s) const {
  const double time = loops_ && duration_s_ > 0 ? time_s - duration_s_ * std::floor(time_s / duration_s_) : time_s;
  std::vector<Vec3> handles = rest_;
  for (const Move& move : moves_) {
    const std::vector<double> values = move.track.at(time);
    for (std::size_t i = 0; i < move.handles.size(); ++i) {
      Vec3& p = handles[move.handles[i]];
      p = moved_by(move, box_, p, i, values);
    }
  }
  return handles;
}

}  // namespace eigencast::deform
