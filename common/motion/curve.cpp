// SPDX-License-Identifier: MIT
#include "common/motion/curve.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace eigencast {
namespace {

// Differences as doubles: two int64 times of hostile origin may lie further apart than an int64 holds.
double span(TimeUs from, TimeUs to) {
  return static_cast<double>(to) - static_cast<double>(from);
}

double fraction_between(TimeUs from_us, TimeUs to_us, TimeUs t_us) {
  assert(from_us < to_us);
  return std::clamp(span(from_us, t_us) / span(from_us, to_us), 0.0, 1.0);
}

}  // namespace

CurveWeights catmull_rom_weights(std::optional<TimeUs> before_us, TimeUs from_us, TimeUs to_us,
                                 std::optional<TimeUs> after_us, TimeUs t_us) {
  const double u = fraction_between(from_us, to_us, t_us), h = span(from_us, to_us);
  // A parabola departs from the chord by u (u - 1) bend, bend = h^2 * second divided difference of the three keys.
  // The cubic has bend0 at u = 0 and bend1 at u = 1: chord + u (u - 1) ((1 - u) bend0 + u bend1).
  const double share = u * (u - 1);
  const double share0 = !after_us ? share : share * (1 - u), share1 = !before_us ? share : share * u;
  CurveWeights w{0, 1 - u, u, 0};
  if (before_us) {
    const double g = span(*before_us, from_us);
    assert(g > 0);
    // h^2 [ (c2 - c1)/h - (c1 - c0)/g ] / (g + h)
    const double scale = share0 * h / (g + h);
    w.before += scale * h / g;
    w.from -= scale * (1 + h / g);
    w.to += scale;
  }
  if (after_us) {
    const double g = span(to_us, *after_us);
    assert(g > 0);
    const double scale = share1 * h / (g + h);
    w.from += scale;
    w.to -= scale * (1 + h / g);
    w.after += scale * h / g;
  }
  return w;
}

double damped_steps(double steps, double damping) {
  assert(steps >= 0 && damping > 0 && damping <= 1);
  if (damping == 1) return steps;
  const double whole = std::floor(steps), power = std::pow(damping, whole);
  return damping * (1 - power) / (1 - damping) + power * damping * (steps - whole);
}

}  // namespace eigencast
