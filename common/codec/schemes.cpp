// SPDX-License-Identifier: MIT
#include "common/codec/schemes.h"

#include <algorithm>
#include <cassert>
#include <cfloat>
#include <cmath>
#include <string>

#include "common/codec/fixed.h"
#include "common/codec/key_parts.h"

namespace eigencast {
namespace {

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
      if (!set_value(key, i)) return overflow(i);
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

Result<Key> hermite_keys(const CoefficientLayout& layout, const VelocityChannels& velocities, const Key& a,
                         const Key& b, TimeUs span_us, std::uint32_t at, std::uint32_t of) {
  assert(2 * velocities.count <= layout.channels && velocities.unit_us > 0);
  auto linear = interpolate_keys(layout, a, b, at, of);
  if (!linear || velocities.count == 0 || span_us <= 0 || span_us > kLongestHermiteUs) return linear;
  assert(of <= 15);
  const BandMask bands = linear->bands;
  const CubicShares share(at, of);
  const fixed::Rescale rule(a.step, b.step);
  const std::size_t channels = layout.channels, to_velocity = channels - velocities.count;
  return with_values(layout, bands, std::move(*linear), [&](Key& out, std::size_t i) {
    if (i % channels >= velocities.count) return true;
    const std::size_t v = i + to_velocity;
    if (is_float(layout)) {
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
    if (is_float(layout)) {
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
  for (std::size_t k = 0; !is_float(layout) && k < keys.size(); ++k)
    scaled[k] *= step_size(keys[k]->step) / step_size(step);
  return with_values(layout, bands, empty_key(layout, bands, step), [&](Key& out, std::size_t i) {
    double sum = 0;
    for (std::size_t k = 0; k < keys.size(); ++k)
      sum += scaled[k] * (is_float(layout) ? keys[k]->f[i] : static_cast<double>(keys[k]->q[i]));
    if (is_float(layout)) return set(layout, out, i, sum);
    return std::abs(sum) < 2e9 && set(out, i, static_cast<std::int64_t>(std::llround(sum)));
  });
}

}  // namespace eigencast
