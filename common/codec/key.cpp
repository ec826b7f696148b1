// SPDX-License-Identifier: MIT
#include "common/codec/key.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cfloat>
#include <cmath>
#include <string>

#include "common/codec/fixed.h"
#include "common/codec/key_parts.h"

namespace eigencast {
namespace {

constexpr int kTableOrigin = 160;
/// The state's step is 6 to 11 times finer than half the spacing of levels, which meets any bound to within 3 %. 4 times
/// costs 1 % more bits; 12 times 0.5 % fewer, but leaves rate control less room.
constexpr unsigned kFinestHalfSpacing = 6;
/// m over the rms error of a value, measured on moving surfaces; 1.8 where no level is 0.
constexpr double kHalfSpacingOverRms = 1.8;

Result<double> as_carried(CodecKind kind, double value) {
  if (kind == CodecKind::kFloat64) return value;
  if (std::abs(value) > double{FLT_MAX}) return fail(ErrorCode::kTooLarge, "a value is beyond float32");
  return double{static_cast<float>(value)};
}

/// a + round_half_away((b - a) * at / of), of = `parts`, at = half of `twice_at`, for |b - a| <= 2^31, at < of <=
/// 65535. Doubles vectorise, and are exact here: the numerator stays below 2^53, and a quotient that is not an integer
/// differs from one by more than its rounding.
std::int32_t between(std::int32_t a, std::int32_t b, double twice_at, double parts) {
  const double difference = static_cast<double>(b) - static_cast<double>(a);
  const auto magnitude = static_cast<std::int32_t>((std::abs(difference) * twice_at + parts) / (2 * parts));
  return a + (difference < 0 ? -magnitude : magnitude);
}

/// The values [first, last) of the pose at/of between quantised keys.
Result<void> interpolate_quantised(const Key& a, const Key& b, std::uint32_t at, std::uint32_t of, std::size_t first,
                                   std::size_t last, Key& out) {
  const std::int32_t* from = a.q.data();
  if (a.step != b.step) {
    const fixed::Rescale rule(a.step, b.step);
    for (std::size_t i = first; i < last; ++i) {
      const std::int64_t value = rule(a.q[i]);
      if (!fixed::in_range(value)) return overflow(i);
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

Result<void> interpolate_floats(CodecKind codec, const Key& a, const Key& b, std::uint32_t at, std::uint32_t of,
                                std::size_t first, std::size_t last, Key& out) {
  for (std::size_t i = first; i < last; ++i) {
    const double value = a.f[i] + (b.f[i] - a.f[i]) * at / of;
    if (!std::isfinite(value)) return overflow(i);
    const auto carried = as_carried(codec, value);
    if (!carried) return carried.error();
    out.f[i] = *carried;
  }
  return {};
}

}  // namespace

Result<CodecKind> codec_from_name(std::string_view name) {
  const auto found = std::find(kCodecNames.begin(), kCodecNames.end(), name);
  if (found != kCodecNames.end()) return static_cast<CodecKind>(found - kCodecNames.begin());
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

double step_size(std::uint8_t index) {
  // The doubles nearest to 2^(0/4) .. 2^(3/4), so that the table is the same on every machine.
  constexpr std::array<double, 4> kFourthRoots = {1.0, 0x1.306fe0a31b715p+0, 0x1.6a09e667f3bcdp+0,
                                                  0x1.ae89f995ad3adp+0};
  return std::ldexp(kFourthRoots[index % 4u], index / 4 - kTableOrigin / 4);
}

std::uint8_t step_index_below(double size) {
  int low = 0;
  int high = 255;
  while (low < high) {
    const int middle = (low + high + 1) / 2;
    if (step_size(static_cast<std::uint8_t>(middle)) <= size) {
      low = middle;
    } else {
      high = middle - 1;
    }
  }
  return static_cast<std::uint8_t>(low);
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
  Key key = empty_key(layout, layout.all_bands(), is_float(layout) ? std::uint8_t{0} : step);
  const double size = step_size(step);
  for (std::size_t i = 0; i < C.size(); ++i) {
    if (!std::isfinite(C[i])) {
      return fail(ErrorCode::kInvalidArgument, "coefficients: value " + std::to_string(i) + " is not finite");
    }
    if (is_float(layout)) {
      const auto value = as_carried(layout.codec, C[i]);
      if (!value) return value.error();
      key.f[i] = *value;
    } else {
      const double rounded = std::round(C[i] / size);
      if (!(std::abs(rounded) <= double{fixed::kMaxValue})) return overflow(i);
      key.q[i] = static_cast<std::int32_t>(rounded);
    }
  }
  return key;
}

std::vector<double> coefficients_from_key(const CoefficientLayout& layout, const Key& key) {
  if (is_float(layout)) return key.f;
  const double size = step_size(key.step);
  std::vector<double> C(key.q.size());
  std::transform(key.q.begin(), key.q.end(), C.begin(), [size](std::int32_t q) { return q * size; });
  return C;
}

Result<Key> rescale(const Key& key, std::uint8_t step) {
  Key out = key;
  out.step = step;
  const fixed::Rescale rule(key.step, step);
  for (std::size_t i = 0; i < key.q.size(); ++i) {
    const std::int64_t value = rule(key.q[i]);
    if (!fixed::in_range(value)) return overflow(i);
    out.q[i] = static_cast<std::int32_t>(value);
  }
  return out;
}

Result<Key> interpolate_keys(const CoefficientLayout& layout, const Key& a, const Key& b, std::uint32_t at,
                             std::uint32_t of) {
  if (of < 1 || of > 65535 || at > of) {
    return fail(ErrorCode::kInvalidArgument, "interpolation: step " + std::to_string(at) + "/" + std::to_string(of) +
                                                 " is not between 0 and 1 in up to 65535 parts");
  }
  Key out = empty_key(layout, a.bands & b.bands, b.step);
  for (std::size_t band = 0; band < layout.band_ends.size(); ++band) {
    if (!out.bands.has(band)) continue;
    const auto [first, last] = layout.range(band);
    const auto done = is_float(layout) ? interpolate_floats(layout.codec, a, b, at, of, first, last, out)
                                       : interpolate_quantised(a, b, at, of, first, last, out);
    if (!done) return done.error();
  }
  return out;
}

}  // namespace eigencast
