// SPDX-License-Identifier: MIT
#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <string>

#include "common/surface/shapes/shapes.h"

namespace eigencast {
namespace {

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

double value_of(double a) {
  return a;
}
double value_of(Dual a) {
  return a.value;
}

constexpr double kTurn = 2 * std::numbers::pi;
constexpr double kMaxRateHz = 1000;

// Each moves one rest position at `phase` in [0, 1), with period 1. T is double or, for velocities, Dual.
using std::cos, std::exp, std::sin;

template <typename T>
using Position = std::array<T, 3>;

// Radial wobble in spherical harmonics of degree 2 and 3 (unnormalised), each at its own multiple of the turn.
template <typename T>
Position<T> wobble(const Vec3& p, T phase) {
  const T a = kTurn * phase;
  const T radius = 1 + 0.18 * sin(a) * (1.5 * p[1] * p[1] - 0.5) + 0.12 * sin(2 * a) * (p[0] * p[0] - p[2] * p[2]) +
                   0.25 * (1 - cos(a)) * p[0] * p[1] * p[2] + 0.08 * sin(3 * a) * p[0] * (5 * p[1] * p[1] - 1) / 2;
  return {p[0] * radius, p[1] * radius, p[2] * radius};
}

constexpr double kTorusMajor = 1;
constexpr double kTorusMinor = 0.4;

// A swelling with three crests runs once round every three turns of the wave; the ring sways with it.
template <typename T>
Position<T> travelling_wave(const Vec3& p, T phase) {
  const double ring = std::hypot(p[0], p[2]);
  const double around = std::atan2(-p[2], p[0]);
  const T crest = 3 * around - kTurn * phase;
  const T swell = 1 + 0.25 * sin(crest);
  const T radius = kTorusMajor + (ring - kTorusMajor) * swell;
  return {p[0] / ring * radius, p[1] * swell + 0.12 * cos(crest), p[2] / ring * radius};
}

constexpr double kBarLength = 4.625;  // 185 quads of the size of the 40 across a side of length 1

// Turns each cross-section round the long axis (Y); `angle` is that between the two ends.
template <typename T>
Position<T> twisted(const Position<T>& p, T angle) {
  const T a = angle * p[1] / kBarLength;
  return {p[0] * cos(a) + p[2] * sin(a), p[1], -p[0] * sin(a) + p[2] * cos(a)};
}

// Lays the long axis on an arc of the same length in the XY plane; `angle` is that between the two ends.
template <typename T>
Position<T> bent(const Position<T>& p, T angle) {
  const T a = angle * p[1] / kBarLength;
  const bool straight = std::abs(value_of(a)) < 1e-9;
  const T along = straight ? p[1] : p[1] * sin(a) / a;
  const T aside = straight ? p[1] * a / 2 : p[1] * (1 - cos(a)) / a;
  // Half the sagitta back, so that the bar swings about its middle.
  const T half = angle / 2;
  const T sagitta = std::abs(value_of(half)) < 1e-9 ? T(0) : kBarLength / 2 * (1 - cos(half)) / half;
  return {aside + p[0] * cos(a) - sagitta / 2, along - p[0] * sin(a), p[2]};
}

template <typename T>
Position<T> bar_twist(const Vec3& p, T phase) {
  return twisted<T>({p[0], p[1], p[2]}, std::numbers::pi * sin(kTurn * phase));
}

template <typename T>
Position<T> bar_bend(const Vec3& p, T phase) {
  return bent<T>({p[0], p[1], p[2]}, std::numbers::pi * sin(kTurn * phase));
}

template <typename T>
Position<T> bar_both(const Vec3& p, T phase) {
  const T angle = std::numbers::pi / 2 * sin(kTurn * phase);
  return bent<T>(twisted<T>({p[0], p[1], p[2]}, angle), angle);
}

// Has height 1 at `centre` and period 1.
template <typename T>
T pulse(T phase, double centre, double sharpness) {
  return exp(sharpness * (cos(kTurn * (phase - centre)) - 1));
}

// Atria (above) contract first, then the ventricles (below), which shorten, narrow and wring about the long axis;
// between beats the heart fills a little beyond rest.
template <typename T>
Position<T> beat(const Vec3& p, T phase) {
  const T atria = pulse(phase, 0.15, 8);
  const T ventricles = pulse(phase, 0.4, 5);
  const T filling = pulse(phase, 0.85, 3);
  const double above = 0.5 * (1 + std::tanh(3 * (p[1] - 0.35)));
  const T squeeze = 0.07 * atria * above + 0.16 * ventricles * (1 - 0.7 * above) - 0.03 * filling;
  const T angle = 0.45 * ventricles * (0.5 - p[1]) + 0.06 * atria * above;
  const T x = p[0] * (1 - squeeze);
  const T z = p[2] * (1 - squeeze);
  const double height = p[1] - 0.5;
  const T y = 0.5 + height * (1 - 0.1 * ventricles * (1 - above) + 0.02 * filling) + 0.03 * atria * above;
  return {x * cos(angle) + z * sin(angle), y, -x * sin(angle) + z * cos(angle)};
}

struct Builtin {
  std::string_view name;
  Surface (*make)();
  Vec3 (*position)(const Vec3& rest, double phase);
  Position<Dual> (*moving)(const Vec3& rest, Dual phase);
  double period_s;
};

Surface make_bar() {
  return make_box(40, 185, 40, {1, kBarLength, 1});
}

constexpr Builtin kBuiltins[] = {
    {"sphere", [] { return make_icosphere(5); }, wobble<double>, wobble<Dual>, 3},
    {"torus", [] { return make_torus(160, 64, kTorusMajor, kTorusMinor); }, travelling_wave<double>,
     travelling_wave<Dual>, 2},
    {"bar", make_bar, bar_both<double>, bar_both<Dual>, 4},
    {"bar:twist", make_bar, bar_twist<double>, bar_twist<Dual>, 4},
    {"bar:bend", make_bar, bar_bend<double>, bar_bend<Dual>, 4},
    {"bar:both", make_bar, bar_both<double>, bar_both<Dual>, 4},
    {"heart", [] { return make_heart(27); }, beat<double>, beat<Dual>, 1},
    {"heart:fine", [] { return make_heart(75); }, beat<double>, beat<Dual>, 1},
};

class BuiltinClip final : public MotionClip {
 public:
  BuiltinClip(const Builtin& builtin, double frame_rate_hz)
      : builtin_(builtin),
        rest_(builtin.make()),
        frame_rate_hz_(frame_rate_hz),
        frame_count_(static_cast<std::size_t>(std::max(1.0, std::round(builtin.period_s * frame_rate_hz)))) {}

  const Surface& rest() const override { return rest_; }
  std::size_t frame_count() const override { return frame_count_; }
  double frame_rate_hz() const override { return frame_rate_hz_; }
  std::string name() const override { return std::string(builtin_.name); }

  Result<std::vector<Vec3>> pose(std::size_t frame) const override {
    assert(frame < frame_count_);
    const double phase = static_cast<double>(frame) / static_cast<double>(frame_count_);
    std::vector<Vec3> positions;
    positions.reserve(rest_.vertex_count());
    for (const Vec3& p : rest_.positions) positions.push_back(builtin_.position(p, phase));
    return positions;
  }

  bool has_velocities() const override { return true; }
  Result<std::vector<Vec3>> velocity(std::size_t frame) const override {
    assert(frame < frame_count_);
    const double turn_s = static_cast<double>(frame_count_) / frame_rate_hz_;
    const Dual phase(static_cast<double>(frame) / static_cast<double>(frame_count_), 1 / turn_s);
    std::vector<Vec3> velocities;
    velocities.reserve(rest_.vertex_count());
    for (const Vec3& p : rest_.positions) {
      const Position<Dual> moving = builtin_.moving(p, phase);
      velocities.push_back({moving[0].slope, moving[1].slope, moving[2].slope});
    }
    return velocities;
  }

 private:
  const Builtin& builtin_;
  Surface rest_;
  double frame_rate_hz_;
  std::size_t frame_count_;
};

}  // namespace

std::vector<std::string> builtin_names() {
  std::vector<std::string> names;
  for (const Builtin& builtin : kBuiltins) names.emplace_back(builtin.name);
  return names;
}

Result<std::unique_ptr<MotionClip>> builtin_clip(std::string_view name, double frame_rate_hz) {
  if (!(frame_rate_hz > 0 && frame_rate_hz <= kMaxRateHz)) {
    return fail(ErrorCode::kInvalidArgument,
                "a frame rate of " + std::to_string(frame_rate_hz) + " Hz; give one above 0 and at most 1000");
  }
  std::string names;
  for (const Builtin& builtin : kBuiltins) {
    if (builtin.name == name) return std::unique_ptr<MotionClip>(std::make_unique<BuiltinClip>(builtin, frame_rate_hz));
    names += names.empty() ? "" : ", ";
    names += builtin.name;
  }
  return fail(ErrorCode::kNotFound, "no built-in shape \"" + std::string(name) + "\"; there are " + names);
}

}  // namespace eigencast
