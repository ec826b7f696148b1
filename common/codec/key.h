// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

#include "common/core/bands.h"
#include "common/core/clock.h"
#include "common/core/result.h"
#include "common/core/text.h"

namespace eigencast {

enum class CodecKind : std::uint8_t { kFloat64 = 0, kFloat32 = 1, kQuantised = 2 };

inline constexpr EnumNames<CodecKind, 3> kCodecNames{{"float64", "float32", "quantised"}};
constexpr std::string_view name_of(CodecKind kind) {
  return kCodecNames[kind];
}
Result<CodecKind> codec_from_name(std::string_view name);

/// The shape of a stream's coefficient matrix C (r x c, row-major) and how it is cut into bands.
struct CoefficientLayout {
  CodecKind codec = CodecKind::kQuantised;
  std::uint32_t rows = 0;                ///< r
  std::uint32_t channels = 3;            ///< c
  std::vector<std::uint32_t> band_ends;  ///< Band b holds rows [band_ends[b-1], band_ends[b]); last == rows.

  std::size_t size() const { return std::size_t{rows} * channels; }
  bool is_float() const { return codec != CodecKind::kQuantised; }
  BandMask all_bands() const { return BandMask::lowest(band_ends.size()); }
  /// The values [first, last) of band b in the row-major matrix.
  std::pair<std::size_t, std::size_t> range(std::size_t band) const { return band_range(band_ends, band, channels); }
  bool operator==(const CoefficientLayout&) const = default;
};

/// The default bands of r rows end at 14, 54, 104 (four affine columns, then whole turns of the augmented basis), r.
std::vector<std::uint32_t> default_band_ends(std::uint32_t rows);

/// The coefficients of one pose, a keyframe or an interpolated frame, as the codec carries them: integers (kQuantised)
/// or doubles (float codecs). Values of absent bands are 0.
struct Key {
  BandMask bands;               ///< The bands present.
  std::uint8_t step = 0;        ///< Index into the step table; 0 for float codecs.
  std::vector<std::int32_t> q;  ///< kQuantised: r*c integers, value = q * step_size(step).
  std::vector<double> f;        ///< Float codecs: r*c values.
  bool operator==(const Key&) const = default;
};

/// A key whose values are all 0. `step` must be 0 with float codecs.
Key empty_key(const CoefficientLayout& layout, BandMask bands, std::uint8_t step);

/// The quantiser steps: step_size(i) = 2^((i - 160) / 4), i = 0..255 (from 9.1e-13 to 1.4e7).
double step_size(std::uint8_t index);
/// Finds the largest step that is not above `size`; clamped to the table.
std::uint8_t step_index_below(double size);

/// How finely keys are held and coded: the state's step, and the half spacing m of the levels of coarse runs in steps.
struct Quantiser {
  std::uint8_t step = 0;
  std::uint8_t half_spacing = 0;
  bool operator==(const Quantiser&) const = default;
};

/// The coarsest quantiser whose keys are, in the area-weighted root mean square over a moving surface, within `eps` of
/// the coefficients' own surface (Parseval, docs/maths.md).
///   eps   model units;  area  of the rest surface, = trace M;  rows  r
Quantiser quantiser_for_error(double eps, double area, std::uint32_t rows);

/// The area-weighted rms distance of the surfaces of two coefficient matrices: |A - B| / sqrt(area), by Parseval.
double surface_distance(std::span<const double> A, std::span<const double> B, double area);

/// Rounds C (r x c, row-major) to a key with all bands. `step` is ignored by float codecs (kFloat32 rounds to float).
/// Errors: kInvalidArgument (size is not r*c, a value is not finite), kTooLarge (a value / step beyond +-2^30).
Result<Key> key_from_coefficients(const CoefficientLayout& layout, std::span<const double> C, std::uint8_t step);

std::vector<double> coefficients_from_key(const CoefficientLayout& layout, const Key& key);

// Poses made from keys (docs/protocol.md, "Integer arithmetic"), in the bands that all keys have. Errors of all:
// kTooLarge (a value leaves the codec's range).

/// The pose `at`/`of` of the way from key a to key b (Eq. 7 of Zhang et al. 2013, "Streaming 3D deforming surfaces with
/// dynamic resolution control"). Integers: a is rescaled to b's step, then q = qa + round_half_away((qb - qa) * at /
/// of), bit-exact everywhere. Doubles: fa + (fb - fa) * at / of; fb itself at the end. REQUIRES: keys of `layout`.
/// Errors: kInvalidArgument (unless at <= of and 1 <= of <= 65535).
Result<Key> interpolate_keys(const CoefficientLayout& layout, const Key& a, const Key& b, std::uint32_t at,
                             std::uint32_t of);

/// The last `count` channels of a format are velocities of its first `count`: movement per `unit_us` microseconds.
struct VelocityChannels {
  std::uint32_t count = 0;
  std::uint32_t unit_us = 1'000'000;
  bool operator==(const VelocityChannels&) const = default;
};

/// Keys further apart are interpolated in a straight line, so that the arithmetic stays within 64 bits.
inline constexpr TimeUs kLongestHermiteUs = 1'000'000;

/// The cubic of Hermite at `at`/`of` of the way from key a to key b, `span_us` later, with the velocities that both
/// carry; bit-exact everywhere for quantised keys. Other channels, and velocities themselves, are interpolated as by
/// interpolate_keys. REQUIRES: as interpolate_keys; of <= 15.
Result<Key> hermite_keys(const CoefficientLayout& layout, const VelocityChannels& velocities, const Key& a,
                         const Key& b, TimeUs span_us, std::uint32_t at, std::uint32_t of);

/// The pose `at`/`of` key intervals beyond `newer` (Zhang et al. 2013, Eq. 9): newer + s (newer - older), s = at/of.
/// If `damped`, each further interval moves 27/32 as far as the one before. Bit-exact everywhere for quantised keys.
/// Moves bands of both keys, holds those of the newer one alone. REQUIRES: both keys fit `layout`, 1 <= at, of <= 15.
Result<Key> estimate_keys(const CoefficientLayout& layout, const Key& older, const Key& newer, bool damped,
                          std::uint32_t at, std::uint32_t of);

/// The sum of weights[i] * keys[i] at the step of the key `step_from`, rounded to nearest. For senders of poses; not
/// bit-exact. REQUIRES: as many weights as keys, at least one, keys fit `layout`, step_from < keys.size().
Result<Key> blend_keys(const CoefficientLayout& layout, std::span<const Key* const> keys,
                       std::span<const double> weights, std::size_t step_from);

}  // namespace eigencast
