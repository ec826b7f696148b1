// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>

#include "common/codec/key.h"
#include "common/core/clock.h"

/// Poses made from keys, beside the linear interpolate_keys (docs/protocol.md, "Integer arithmetic"), in the bands that all
/// keys have. Errors of all: kTooLarge (a value leaves the codec's range).
namespace eigencast {

/// The last `count` channels of a format are velocities of its first `count`: movement per `unit_us` microseconds.
struct VelocityChannels {
  std::uint32_t count = 0;
  std::uint32_t unit_us = 1'000'000;
  bool operator==(const VelocityChannels&) const = default;
};

/// Keys further apart than this are interpolated in a straight line, so that the arithmetic stays within 64 bits.
inline constexpr TimeUs kLongestHermiteUs = 1'000'000;

/// The cubic of Hermite at `at`/`of` of the way from key a to key b, `span_us` later, with the velocities that both
/// carry; bit-exact everywhere for quantised keys. Other channels, and velocities themselves, are interpolated as by
/// interpolate_keys. REQUIRES: as interpolate_keys; of <= 15.
Result<Key> hermite_keys(const CoefficientLayout& layout, const VelocityChannels& velocities, const Key& a,
                         const Key& b, TimeUs span_us, std::uint32_t at, std::uint32_t of);

/// The pose `at`/`of` key intervals beyond `newer` (Eq. 9 of Zhang, Dou, Zhou, Wu 2013, "Streaming 3D deforming
/// surfaces with dynamic resolution control"): newer + s (newer - older) with s = at/of, or, `damped`, with each
/// further interval moving 27/32 as far as the one before. Bit-exact everywhere for quantised keys. Moves bands of both
/// keys and holds those of the newer one alone. REQUIRES: both keys fit `layout`, 1 <= at, of <= 15.
Result<Key> estimate_keys(const CoefficientLayout& layout, const Key& older, const Key& newer, bool damped,
                          std::uint32_t at, std::uint32_t of);

/// The sum of weights[i] * keys[i] at the step of the key `step_from`, rounded to nearest. For senders of poses; not
/// bit-exact. REQUIRES: as many weights as keys, at least one, keys fit `layout`, step_from < keys.size().
Result<Key> blend_keys(const CoefficientLayout& layout, std::span<const Key* const> keys,
                       std::span<const double> weights, std::size_t step_from);

}  // namespace eigencast
