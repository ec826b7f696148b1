// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <span>
#include <vector>

#include "common/codec/band.h"
#include "common/codec/fixed.h"

/// What coder and decoder of coarse runs must agree on bit by bit (docs/protocol.md, "Coarse runs"): prediction, levels,
/// and how likely each level is.
namespace eigencast::band {

/// Of the two reconstruction rules one is in force at each value, chosen by the parities of the levels before it (trellis
/// coded quantisation: Marcellin & Fischer 1990; in this form: Schwarz et al. 2021, "Quantization and entropy coding in
/// the Versatile Video Coding standard"). In units of m, rule 0 has the points 0, 2, 4, ... and rule 1 has 0, 1, 3, 5, ...
inline constexpr std::array<std::array<std::uint8_t, 2>, 4> kNextState = {{{0, 2}, {2, 0}, {1, 3}, {3, 1}}};
inline constexpr unsigned rule_of(unsigned state) {
  return state >> 1;
}
inline constexpr std::int64_t point(unsigned rule, std::int64_t level) {
  return level == 0 ? 0 : 2 * level - static_cast<std::int64_t>(rule);
}

/// Second order prediction: an oscillation, damped or driven, that starts from c1 at the speed c1 - c2.
struct Predictor {
  unsigned speed = 4;       ///< Weight of c1 - c2, (speed - 4) / 8; 0..15.
  unsigned restoring = 12;  ///< Weight of c1, (restoring - 12) / 16; 0..15.

  std::int64_t operator()(std::int64_t c1, std::int64_t c2) const {
    const std::int64_t v = 2 * (std::int64_t{speed} - 4) * (c1 - c2) + (std::int64_t{restoring} - 12) * c1;
    return c1 + ((v + 8) >> 4);
  }
};

inline constexpr unsigned kAllZero = 31;    ///< Scale code: every level is 0.
inline constexpr unsigned kMaxUnary = 24;   ///< Levels from here on are escaped.
inline constexpr unsigned kContexts = 160;  ///< Context i stands for a mean magnitude of about 2^(i/8 - 12) spacings.
inline constexpr unsigned kLowestOffset = 16;

/// exp(-1 / (4 s)) in units of 2^-15, s the magnitude that context i - kLowestOffset stands for; kept within
/// [64, 2^15 - 64].
extern const std::array<std::uint16_t, kContexts + kLowestOffset> kMore;

/// Probabilities that a level goes on beyond 0, 1 and any later count.
struct LevelOdds {
  unsigned beyond_0, beyond_1, later;  ///< Indices into kMore.
  LevelOdds(unsigned rule, unsigned context)
      : beyond_0(context + kLowestOffset - (rule == 0 ? 8 : 0)),
        beyond_1(context + kLowestOffset - (rule == 0 ? 16 : 13)),
        later(context + kLowestOffset - 16) {}
};

/// The magnitude that a scale code stands for.
inline std::int64_t magnitude_of(unsigned scale_code, unsigned half_spacing) {
  return (std::int64_t{2} * half_spacing * ((scale_code & 1) == 0 ? 16 : 23) << (scale_code >> 1)) >> 9;
}

/// Foretells the magnitude of each residual of a band from the speeds, the residuals before it, and the band's scale.
class ContextModel {
 public:
  /// speeds  |c1 - c2| of each value; must outlive this
  ContextModel(std::span<const std::uint32_t> speeds, const Spacing& spacing, unsigned scale_code)
      : speeds_(speeds),
        channels_(spacing.channels),
        inverse_(65536 / spacing.channels),
        unit_(log_of(std::int64_t{128} * spacing.half) - 96),
        base_(19 * magnitude_of(scale_code, spacing.half) + (spacing.half >> 1) + 8),
        recent_(16 * magnitude_of(scale_code, spacing.half)) {}

  /// The context of the next value.
  unsigned next() {
    if (channel_ == 0) begin_row();
    const std::int64_t beside = channel_ == 0   ? recent_ >> 4
                                : channel_ == 1 ? row_sum_
                                                : (row_sum_ * (65536 / channel_)) >> 16;
    const std::int64_t sum = row_ + 7 * std::int64_t{speeds_[at_]} + 6 * beside;
    const int context = log_of(sum) - unit_;
    return context < 0 ? 0 : context >= static_cast<int>(kContexts) ? kContexts - 1 : static_cast<unsigned>(context);
  }

  /// Its residual turned out to be of this magnitude.
  void add(std::int64_t magnitude) {
    row_sum_ += magnitude;
    ++at_;
    if (++channel_ < channels_) return;
    recent_ += (((row_sum_ * inverse_) >> 12) - recent_) >> 2;
    row_sum_ = 0;
    channel_ = 0;
  }

 private:
  /// 8 log2(x), piecewise linear between powers of two. REQUIRES: x >= 8.
  static int log_of(std::int64_t x) {
    const int whole = std::bit_width(static_cast<std::uint64_t>(x)) - 1;
    return whole << 3 | static_cast<int>(x >> (whole - 3) & 7);
  }
  void begin_row() {
    std::int64_t speed = 0;
    for (unsigned channel = 0; channel < channels_; ++channel) speed += speeds_[at_ + channel];
    row_ = base_ + 4 * ((speed * inverse_) >> 16) + ((19 * recent_) >> 4);
  }

  std::span<const std::uint32_t> speeds_;
  unsigned channels_;
  std::int64_t inverse_;
  int unit_;
  std::int64_t base_;
  std::int64_t recent_;  ///< Mean magnitude of the rows before this one, the latest counting most; in sixteenths.
  std::int64_t row_ = 0;
  std::int64_t row_sum_ = 0;
  unsigned channel_ = 0;
  std::size_t at_ = 0;
};

/// Where a coarse run starts from: what the two keys before it say about the band.
struct Motion {
  explicit Motion(const References& from) : c1(from.c1), c2(from.c2.empty() ? from.c1 : from.c2), speeds(c1.size()) {
    for (std::size_t i = 0; i < c1.size(); ++i) {
      const std::int64_t speed = std::int64_t{c1[i]} - c2[i];
      speeds[i] = static_cast<std::uint32_t>(speed < 0 ? -speed : speed);
    }
  }
  std::span<const std::int32_t> c1, c2;
  std::vector<std::uint32_t> speeds;
};

}  // namespace eigencast::band
