// SPDX-License-Identifier: MIT
#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <string>
#include <utility>

#include "common/surface/shapes.h"

namespace eigencast {
namespace {

constexpr double kTurn = 2 * std::numbers::pi;
constexpr double kMaxRateHz = 1000;

// Moves one rest position at `phase` in [0, 1), smoothly and with period 1.
using Motion = Vec3 (*)(const Vec3& rest, double phase);

struct Builtin {
  std::string_view name;
  Surface (*make)();
  Motion motion;
  double period_s;
};

// Radial wobble in spherical harmonics of degree 2 and 3 (unnormalised), each at its own multiple of the turn.
Vec3 wobble(const Vec3& p, double phase) {
  const double a = kTurn * phase;
  const double radius =
      1 + 0.18 * std::sin(a) * (1.5 * p[1] * p[1] - 0.5) + 0.12 * std::sin(2 * a) * (p[0] * p[0] - p[2] * p[2]) +
      0.25 * (1 - std::cos(a)) * p[0] * p[1] * p[2] + 0.08 * std::sin(3 * a) * p[0] * (5 * p[1] * p[1] - 1) / 2;
  return {p[0] * radius, p[1] * radius, p[2] * radius};
}

constexpr double kTorusMajor = 1;
constexpr double kTorusMinor = 0.4;

// A swelling with three crests runs once round every three turns of the wave; the ring sways with it.
Vec3 travelling_wave(const Vec3& p, double phase) {
  const double ring = std::hypot(p[0], p[2]);
  const double around = std::atan2(-p[2], p[0]);
  const double crest = 3 * around - kTurn * phase;
  const double swell = 1 + 0.25 * std::sin(crest);
  const double radius = kTorusMajor + (ring - kTorusMajor) * swell;
  return {p[0] / ring * radius, p[1] * swell + 0.12 * std::cos(crest), p[2] / ring * radius};
}

constexpr double kBarLength = 4.625;  // 185 quads of the size of the 40 across a side of length 1

// Turns each cross-section round the long axis (Y); `angle` is that between the two ends.
Vec3 twisted(const Vec3& p, double angle) {
  const double a = angle * p[1] / kBarLength;
  return {p[0] * std::cos(a) + p[2] * std::sin(a), p[1], -p[0] * std::sin(a) + p[2] * std::cos(a)};
}

// Lays the long axis on an arc of the same length in the XY plane; `angle` is that between the two ends.
Vec3 bent(const Vec3& p, double angle) {
  const double a = angle * p[1] / kBarLength;
  const bool straight = std::abs(a) < 1e-9;
  const double along = straight ? p[1] : p[1] * std::sin(a) / a;
  const double aside = straight ? p[1] * a / 2 : p[1] * (1 - std::cos(a)) / a;
  // Half the sagitta back, so that the bar swings about its middle.
  const double half = angle / 2;
  const double sagitta = std::abs(half) < 1e-9 ? 0 : kBarLength / 2 * (1 - std::cos(half)) / half;
  return {aside + p[0] * std::cos(a) - sagitta / 2, along - p[0] * std::sin(a), p[2]};
}

Vec3 bar_twist(const Vec3& p, double phase) {
  return twisted(p, std::numbers::pi * std::sin(kTurn * phase));
}

Vec3 bar_bend(const Vec3& p, double phase) {
  return bent(p, std::numbers::pi * std::sin(kTurn * phase));
}

Vec3 bar_both(const Vec3& p, double phase) {
  const double angle = std::numbers::pi / 2 * std::sin(kTurn * phase);
  return bent(twisted(p, angle), angle);
}

// A smooth pulse of height 1 at `centre`, of period 1.
double pulse(double phase, double centre, double sharpness) {
  return std::exp(sharpness * (std::cos(kTurn * (phase - centre)) - 1));
}

// Atria (above) contract first and gently, then the ventricles (below), which shorten, narrow and wring about the long
// axis, base and apex against each other; between beats the heart fills a little beyond rest.
Vec3 beat(const Vec3& p, double phase) {
  const double atria = pulse(phase, 0.15, 8);
  const double ventricles = pulse(phase, 0.4, 5);
  const double filling = pulse(phase, 0.85, 3);
  const double above = 0.5 * (1 + std::tanh(3 * (p[1] - 0.35)));
  const double squeeze = 0.07 * atria * above + 0.16 * ventricles * (1 - 0.7 * above) - 0.03 * filling;
  const double angle = 0.45 * ventricles * (0.5 - p[1]) + 0.06 * atria * above;
  const double x = p[0] * (1 - squeeze);
  const double z = p[2] * (1 - squeeze);
  const double height = p[1] - 0.5;
  const double y = 0.5 + height * (1 - 0.1 * ventricles * (1 - above) + 0.02 * filling) + 0.03 * atria * above;
  return {x * std::cos(angle) + z * std::sin(angle), y, -x * std::sin(angle) + z * std::cos(angle)};
}

Surface make_bar() {
  return make_box(40, 185, 40, {1, kBarLength, 1});
}

constexpr Builtin kBuiltins[] = {
    {"sphere", [] { return make_icosphere(5); }, wobble, 3},
    {"torus", [] { return make_torus(160, 64, kTorusMajor, kTorusMinor); }, travelling_wave, 2},
    {"bar", make_bar, bar_both, 4},
    {"bar:twist", make_bar, bar_twist, 4},
    {"bar:bend", make_bar, bar_bend, 4},
    {"bar:both", make_bar, bar_both, 4},
    {"heart", [] { return make_heart(27); }, beat, 1},
    {"heart:fine", [] { return make_heart(75); }, beat, 1},
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
    for (const Vec3& p : rest_.positions) positions.push_back(builtin_.motion(p, phase));
    return positions;
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
