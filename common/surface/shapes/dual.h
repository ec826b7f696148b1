// SPDX-License-Identifier: MIT
#pragma once

#include <cmath>

namespace eigencast {

/// A number and its derivative, so that a formula written once gives both exactly (forward-mode differentiation:
/// Wengert 1964, "A simple automatic derivative evaluation program").
struct Dual {
  double value = 0, slope = 0;

  constexpr Dual() = default;
  constexpr Dual(double v, double s = 0) : value(v), slope(s) {}  // NOLINT: a constant is a number that does not move.

  friend constexpr Dual operator+(Dual a, Dual b) { return {a.value + b.value, a.slope + b.slope}; }
  friend constexpr Dual operator-(Dual a, Dual b) { return {a.value - b.value, a.slope - b.slope}; }
  friend constexpr Dual operator-(Dual a) { return {-a.value, -a.slope}; }
  friend constexpr Dual operator*(Dual a, Dual b) { return {a.value * b.value, a.slope * b.value + a.value * b.slope}; }
  friend constexpr Dual operator/(Dual a, Dual b) {
    return {a.value / b.value, (a.slope * b.value - a.value * b.slope) / (b.value * b.value)};
  }
  friend Dual sin(Dual a) { return {std::sin(a.value), a.slope * std::cos(a.value)}; }
  friend Dual cos(Dual a) { return {std::cos(a.value), -a.slope * std::sin(a.value)}; }
  friend Dual exp(Dual a) { return {std::exp(a.value), a.slope * std::exp(a.value)}; }
};

inline double value_of(double a) {
  return a;
}
inline double value_of(Dual a) {
  return a.value;
}

}  // namespace eigencast
