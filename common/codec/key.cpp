// SPDX-License-Identifier: MIT
#include "common/codec/key.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cfloat>
#include <cmath>
#include <string>

#include "common/codec/fixed.h"

namespace eigencast {
namespace {

constexpr int kTableOrigin = 160;
/// The state's step is 6 to 11 times finer than half the spacing of levels, which meets any bound to within 3 %. 4
/// times costs 1 % more bits; 12 times 0.5 % fewer, but leaves rate control less room.
constexpr unsigned kFinestHalfSpacing = 6;
/// m over the rms error of a value, measured on moving surfaces; 1.8 where no level is 0.
constexpr double kHalfSpacingOverRms = 1.8;

Error overflow(const CoefficientLayout& layout, std::size_t index) {
  return fail(ErrorCode::kTooLarge, "coefficient " + std::to_string(index) + " leaves the codec's range: use " +
                                        (layout.is_float() ? "another codec" : "a larger step, or another codec"));
}

/// a + round_half_away((b - a) * at / of), of = `parts`, at = half of `twice_at`, for |b - a| <= 2^31, at < of <=
/// 65535. Doubles vectorise, and are exact here: the numerator stays below 2^53, and a quotient that is not an integer
/// differs from one by more than its rounding.
std::int32_t between(std::int32_t a, std::int32_t b, double twice_at, double parts) {
  const double difference = static_cast<double>(b) - static_cast<double>(a);
  const auto magnitude = static_cast<std::int32_t>((std::abs(difference) * twice_at + parts) / (2 * parts));
  return a + (difference < 0 ? -magnitude : magnitude);
}

Result<void> interpolate_quantised(const CoefficientLayout& layout, const Key& a, const Key& b, std::uint32_t at,
                                   std::uint32_t of, std::size_t first, std::size_t last, Key& out) {
  const std::int32_t* from = a.q.data();
  if (a.step != b.step) {
    const fixed::Rescale rule(a.step, b.step);
    for (std::size_t i = first; i < last; ++i) {
      const std::int64_t value = rule(a.q[i]);
      if (!fixed::in_range(value)) return overflow(layout, i);
      out.q[i] = static_cast<std::int32_t>(value);
    }
    from = out.q.data();
  }
  const std::int32_t* to = b.q.data();
  std::int32_t* made = out.q.data();
  if (at == of) {
    std::copy(to + first, to + last, made + first);
    return {};
  }
  for (std::size_t i = first; i < last; ++i) made[i] = between(from[i], to[i], 2.0 * at, of);
  return {};
}

/// n / d to the nearest integer, halves away from zero. REQUIRES: d > 0, |n| < 2^62, d < 2^32.
std::int64_t rounded_quotient(std::int64_t n, std::int64_t d) {
  const std::int64_t magnitude = (2 * std::abs(n) + d) / (2 * d);
  return n < 0 ? -magnitude : magnitude;
}

bool set(const CoefficientLayout& layout, Key& key, std::size_t i, double value) {
  if (layout.codec == CodecKind::kFloat32)
    value = std::abs(value) <= double{FLT_MAX} ? static_cast<float>(value) : HUGE_VAL;
  key.f[i] = value;
  return std::isfinite(value);
}
bool set(Key& key, std::size_t i, std::int64_t value) {
  key.q[i] = static_cast<std::int32_t>(value);
  return fixed::in_range(value);
}

/// `key` after set_value(key, i) for each value of the bands; where one returns false, that value overflowed.
template <typename SetValue>
Result<Key> with_values(const CoefficientLayout& layout, BandMask bands, Key key, SetValue&& set_value) {
  for (std::size_t band = 0; band < layout.band_ends.size(); ++band) {
    if (!bands.has(band)) continue;
    const auto [first, last] = layout.range(band);
    for (std::size_t i = first; i < last; ++i) {
      if (!set_value(key, i)) return overflow(layout, i);
    }
  }
  return key;
}

/// The Hermite basis at at/of in units of 1/of^3, as integers.
struct CubicShares {
  CubicShares(std::int64_t at, std::int64_t of)
      : whole(of * of * of),
        to(at * at * (3 * of - 2 * at)),
        slope0(at * (of - at) * (of - at)),
        slope1(at * at * (at - of)) {}
  std::int64_t whole, to, slope0, slope1;
};

/// How far an estimate goes, in units of 1/(65536 of) of the newest key's movement.
std::int64_t estimate_weight(bool damped, std::uint32_t at, std::uint32_t of) {
  constexpr std::int64_t kOne = 65536;
  if (!damped) return kOne * at;
  std::int64_t moved = 0, interval = (kOne * 27 + 16) >> 5;
  for (; at >= of; at -= of) {
    moved += interval * of;
    interval = (interval * 27 + 16) >> 5;
  }
  return moved + interval * at;
}

}  // namespace

Result<CodecKind> codec_from_name(std::string_view name) {
  if (const auto codec = kCodecNames.find(name)) return *codec;
  return fail(ErrorCode::kUnsupported,
              "codec '" + std::string(name.substr(0, 32)) + "' is unknown; known: quantised, float32, float64");
}

std::vector<std::uint32_t> default_band_ends(std::uint32_t rows) {
  std::vector<std::uint32_t> ends;
  for (const std::uint32_t end : {14u, 54u, 104u}) {
    if (end < rows) ends.push_back(end);
  }
  ends.push_back(rows);
  return ends;
}

Key empty_key(const CoefficientLayout& layout, BandMask bands, std::uint8_t step) {
  const std::size_t size = layout.size();
  return {bands, step, std::vector<std::int32_t>(layout.is_float() ? 0 : size),
          std::vector<double>(layout.is_float() ? size : 0)};
}

double step_size(std::uint8_t index) {
  // The doubles nearest to 2^(0/4) .. 2^(3/4), so that the table is the same on every machine.
  constexpr std::array<double, 4> kFourthRoots = {1.0, 0x1.306fe0a31b715p+0, 0x1.6a09e667f3bcdp+0,
                                                  0x1.ae89f995ad3adp+0};
  return std::ldexp(kFourthRoots[index % 4u], index / 4 - kTableOrigin / 4);
}

std::uint8_t step_index_below(double size) {
  unsigned index = 0;
  for (unsigned bit = 128; bit > 0; bit >>= 1) {
    if (step_size(static_cast<std::uint8_t>(index | bit)) <= size) index |= bit;
  }
  return static_cast<std::uint8_t>(index);
}

Quantiser quantiser_for_error(double eps, double area, std::uint32_t rows) {
  const double half = kHalfSpacingOverRms * eps * std::sqrt(area / (3.0 * rows));
  Quantiser best{step_index_below(half / kFinestHalfSpacing), kFinestHalfSpacing};
  for (unsigned m = kFinestHalfSpacing; m < 2 * kFinestHalfSpacing; ++m) {
    const std::uint8_t step = step_index_below(half / m);
    if (m * step_size(step) > best.half_spacing * step_size(best.step)) best = {step, static_cast<std::uint8_t>(m)};
  }
  return best;
}

double surface_distance(std::span<const double> A, std::span<const double> B, double area) {
  assert(A.size() == B.size() && area > 0);
  double sum = 0;
  for (std::size_t i = 0; i < A.size(); ++i) sum += (A[i] - B[i]) * (A[i] - B[i]);
  return std::sqrt(sum / area);
}

Result<Key> key_from_coefficients(const CoefficientLayout& layout, std::span<const double> C, std::uint8_t step) {
  if (C.size() != layout.size()) {
    return fail(ErrorCode::kInvalidArgument, "coefficients: " + std::to_string(C.size()) +
                                                 " values where the layout has " + std::to_string(layout.size()));
  }
  Key key = empty_key(layout, layout.all_bands(), layout.is_float() ? std::uint8_t{0} : step);
  const double size = step_size(step);
  for (std::size_t i = 0; i < C.size(); ++i) {
    if (!std::isfinite(C[i])) {
      return fail(ErrorCode::kInvalidArgument, "coefficients: value " + std::to_string(i) + " is not finite");
    }
    const double rounded = std::round(C[i] / size);
    const bool fits = layout.is_float() ? set(layout, key, i, C[i])
                                        : std::abs(rounded) <= double{fixed::kMaxValue} &&
                                              set(key, i, static_cast<std::int64_t>(rounded));
    if (!fits) return overflow(layout, i);
  }
  return key;
}

std::vector<double> coefficients_from_key(const CoefficientLayout& layout, const Key& key) {
  if (layout.is_float()) return key.f;
  const double size = step_size(key.step);
  std::vector<double> C(key.q.size());
  std::transform(key.q.begin(), key.q.end(), C.begin(), [size](std::int32_t q) { return q * size; });
  return C;
}

Result<Key> interpolate_keys(const CoefficientLayout& layout, const Key& a, const Key& b, std::uint32_t at,
                             std::uint32_t of) {
  if (of < 1 || of > 65535 || at > of) {
    return fail(ErrorCode::kInvalidArgument, "interpolation: step " + std::to_string(at) + "/" + std::to_string(of) +
                                                 " is not between 0 and 1 in up to 65535 parts");
  }
  const BandMask bands = a.bands & b.bands;
  Key out = empty_key(layout, bands, b.step);
  if (layout.is_float()) {
    return with_values(layout, bands, std::move(out), [&](Key& made, std::size_t i) {
      return set(layout, made, i, at == of ? b.f[i] : a.f[i] + (b.f[i] - a.f[i]) * at / of);
    });
  }
  for (std::size_t band = 0; band < layout.band_ends.size(); ++band) {
    if (!bands.has(band)) continue;
    const auto [first, last] = layout.range(band);
    if (const auto done = interpolate_quantised(layout, a, b, at, of, first, last, out); !done) return done.error();
  }
  return out;
}

Result<Key> hermite_keys(const CoefficientLayout& layout, const VelocityChannels& velocities, const Key& a,
                         const Key& b, TimeUs span_us, std::uint32_t at, std::uint32_t of) {
  assert(2 * velocities.count <= layout.channels && velocities.unit_us > 0);
  auto linear = interpolate_keys(layout, a, b, at, of);
  if (!linear || at == of || velocities.count == 0 || span_us <= 0 || span_us > kLongestHermiteUs) return linear;
  assert(of <= 15);
  const BandMask bands = linear->bands;
  const CubicShares share(at, of);
  const fixed::Rescale rule(a.step, b.step);
  const std::size_t channels = layout.channels, to_velocity = channels - velocities.count;
  return with_values(layout, bands, std::move(*linear), [&](Key& out, std::size_t i) {
    if (i % channels >= velocities.count) return true;
    const std::size_t v = i + to_velocity;
    if (layout.is_float()) {
      const double whole = static_cast<double>(share.whole);
      const double slopes = a.f[v] * static_cast<double>(share.slope0) + b.f[v] * static_cast<double>(share.slope1);
      const double moved = (b.f[i] - a.f[i]) * static_cast<double>(share.to) / whole;
      return set(layout, out, i, a.f[i] + moved + slopes * static_cast<double>(span_us) / velocities.unit_us / whole);
    }
    const std::int64_t from = rule(a.q[i]), from_velocity = rule(a.q[v]);
    if (!fixed::in_range(from) || !fixed::in_range(from_velocity)) return false;
    const std::int64_t slopes = from_velocity * share.slope0 + std::int64_t{b.q[v]} * share.slope1;
    const std::int64_t bent = rounded_quotient(slopes * span_us, velocities.unit_us);
    // A movement that is out of all proportion is out of range too; below, the sum fits 64 bits.
    if (std::abs(bent) > std::int64_t{1} << 50) return false;
    return set(out, i, from + rounded_quotient((b.q[i] - from) * share.to + bent, share.whole));
  });
}

Result<Key> estimate_keys(const CoefficientLayout& layout, const Key& older, const Key& newer, bool damped,
                          std::uint32_t at, std::uint32_t of) {
  assert(at >= 1 && at <= 15 && of >= 1 && of <= 15);
  const std::int64_t weight = estimate_weight(damped, at, of), whole = std::int64_t{65536} * of;
  const fixed::Rescale rule(older.step, newer.step);
  return with_values(layout, older.bands & newer.bands, newer, [&](Key& out, std::size_t i) {
    if (layout.is_float()) {
      const double steps = static_cast<double>(weight) / static_cast<double>(whole);
      return set(layout, out, i, newer.f[i] + steps * (newer.f[i] - older.f[i]));
    }
    const std::int64_t from = rule(older.q[i]);
    return fixed::in_range(from) && set(out, i, newer.q[i] + rounded_quotient((newer.q[i] - from) * weight, whole));
  });
}

Result<Key> blend_keys(const CoefficientLayout& layout, std::span<const Key* const> keys,
                       std::span<const double> weights, std::size_t step_from) {
  assert(!keys.empty() && keys.size() == weights.size() && step_from < keys.size());
  BandMask bands = layout.all_bands();
  for (const Key* key : keys) bands &= key->bands;
  const std::uint8_t step = keys[step_from]->step;
  std::vector<double> scaled(weights.begin(), weights.end());
  for (std::size_t k = 0; !layout.is_float() && k < keys.size(); ++k)
    scaled[k] *= step_size(keys[k]->step) / step_size(step);
  return with_values(layout, bands, empty_key(layout, bands, step), [&](Key& out, std::size_t i) {
    double sum = 0;
    for (std::size_t k = 0; k < keys.size(); ++k)
      sum += scaled[k] * (layout.is_float() ? keys[k]->f[i] : static_cast<double>(keys[k]->q[i]));
    if (layout.is_float()) return set(layout, out, i, sum);
    return std::abs(sum) < 2e9 && set(out, i, static_cast<std::int64_t>(std::llround(sum)));
  });
}

}  // namespace eigencast
