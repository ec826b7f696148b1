// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cassert>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "common/codec/band.h"
#include "common/codec/fixed.h"

/// The model that coder and decoder of coarse runs share bit by bit (docs/protocol.md, "Coarse runs").
namespace eigencast::band {

/// One of two reconstruction rules applies to each value, selected by the parities of the levels before it
/// (trellis coded quantisation: Marcellin & Fischer 1990; in this form: Schwarz et al. 2021, "Quantization and entropy
/// coding in the Versatile Video Coding standard"). In units of m, rule 0 has the points 0, 2, 4, ... and rule 1 has 0,
/// 1, 3, 5, ...
inline constexpr std::array<std::array<std::uint8_t, 2>, 4> kNextState = {{{0, 2}, {2, 0}, {1, 3}, {3, 1}}};
inline constexpr unsigned rule_of(unsigned state) {
  return state >> 1;
}
inline constexpr std::int64_t point(unsigned rule, std::int64_t level) {
  return level == 0 ? 0 : 2 * level - static_cast<std::int64_t>(rule);
}

inline constexpr unsigned kUsualRestoring = 12;

/// Second order prediction: an oscillation, damped or driven, that starts from c1 at the speed c1 - c2.
struct Predictor {
  unsigned speed = 4;                    ///< Weight of c1 - c2, (speed - 4) / 8; 0..15.
  unsigned restoring = kUsualRestoring;  ///< Weight of c1, (restoring - 12) / 16; 0..15.
};

inline constexpr unsigned kUsualSpeed = 4;
/// Prediction from a memory: its pose, a share of what the latest key had beside the memory's, and of its movement.
/// Its weights stand where S and R do in other coarse runs: is hold not 0? (even), then 2 bits, hold - 1; is speed not
/// 4? (even), then 4 bits. The scale code expected is at most 5; where it is x above E without that limit, the contexts
/// take |d| / 2^floor(x / 2), rounded down.
struct RecallingPredictor {
  unsigned hold = 0;             ///< Weight of c1 - e1, hold / 4; 0..4.
  unsigned speed = kUsualSpeed;  ///< Weight of c1 - c2, (speed - 4) / 8; 0..15.
};

/// What a run's values are predicted to be, rounded to nearest.
class Prediction {
 public:
  /// REQUIRES: all spans of `from` but e and e1 are there, and these where a memory predicts; they outlive this.
  Prediction(const References& from, const Predictor& with) : Prediction(from, from.c1, from.c1, with.speed) {
    of_c1_ += std::int64_t{with.restoring} - kUsualRestoring;
  }
  Prediction(const References& from, const RecallingPredictor& with) : Prediction(from, from.e, from.e1, with.speed) {
    of_c1_ += 4 * std::int64_t{with.hold};
    of_other_ = -4 * std::int64_t{with.hold};
  }

  std::int64_t operator()(std::size_t i) const {
    return start_[i] + ((of_c1_ * c1_[i] + of_c2_ * c2_[i] + of_other_ * other_[i] + 8) >> 4);
  }

 private:
  Prediction(const References& from, std::span<const std::int32_t> start, std::span<const std::int32_t> other,
             unsigned speed)
      : start_(start.data()),
        c1_(from.c1.data()),
        c2_(from.c2.data()),
        other_(other.data()),
        of_c1_(2 * (std::int64_t{speed} - kUsualSpeed)),
        of_c2_(-of_c1_) {}

  const std::int32_t *start_, *c1_, *c2_, *other_;
  std::int64_t of_c1_, of_c2_, of_other_ = 0;  ///< In sixteenths.
};

/// Keys at rest, and a memory that was not used before, stand for themselves.
inline References completed(References from) {
  if (from.c2.empty()) from.c2 = from.c1;
  if (from.e1.empty()) from.e1 = from.e;
  return from;
}

inline constexpr unsigned kMaxScaleCode = 30;
inline constexpr unsigned kMaxUnary = 24;   ///< Levels from here on are escaped.
inline constexpr unsigned kContexts = 160;  ///< Context i: a mean magnitude of about 2^(i/8 - 12) spacings.
inline constexpr unsigned kLowestOffset = 24;

/// exp(-1 / (4 s)) in units of 2^-15, s the magnitude of context i - kLowestOffset; clamped to
/// [64, 2^15 - 64].
extern const std::array<std::uint16_t, kContexts + kLowestOffset> kMore;

/// Probabilities that a level exceeds 0, 1 and any later count.
struct LevelOdds {
  unsigned beyond_0, beyond_1, later;  ///< Indices into kMore.
  LevelOdds(unsigned rule, unsigned context)
      : beyond_0(context + kLowestOffset - (rule == 0 ? 12 : 0)),
        beyond_1(context + kLowestOffset - (rule == 0 ? 20 : 19)),
        later(context + kLowestOffset - 18) {}
};

/// The scale code expected of what a memory predicts is at most this.
inline constexpr unsigned kRecalledScale = 5;
/// That a scale code differs from the expected one, and that it differs by yet another.
inline constexpr std::uint32_t kScaleDiffers = 26000, kScaleFurther = 19000;

inline std::int64_t magnitude_of(unsigned scale_code, unsigned half_spacing) {
  return (std::int64_t{2} * half_spacing * ((scale_code & 1) == 0 ? 16 : 23) << (scale_code >> 1)) >> 9;
}

/// The scale code whose magnitude is nearest below 32/27 of the mean of `count` magnitudes.
inline unsigned scale_code_of(std::uint64_t sum, std::size_t count, unsigned half_spacing) {
  unsigned code = 0;
  while (code < kMaxScaleCode && magnitude_of(code + 1, half_spacing) * static_cast<std::int64_t>(count) * 27 <=
                                     static_cast<std::int64_t>(sum) * 32)
    ++code;
  return code;
}

/// Predicts the magnitude of a residual from its speed, the residuals before it in its channel, and the band's scale.
class ContextModel {
 public:
  /// speeds  |c1 - c2| of each value; must outlive this
  ContextModel(std::span<const std::uint32_t> speeds, const Spacing& spacing, unsigned scale_code)
      : speed_(speeds.data()),
        channels_(spacing.channels),
        unit_(log_of(std::int64_t{128} * spacing.half) - 96),
        base_(16 * magnitude_of(scale_code, spacing.half) + (spacing.half >> 1) + 8) {
    assert(channels_ <= recent_.size());
    std::fill_n(recent_.begin(), channels_, 16 * magnitude_of(scale_code, spacing.half));
  }

  unsigned next() const {
    const std::int64_t sum = base_ + 16 * std::int64_t{*speed_} + 3 * recent_.data()[channel_];
    return static_cast<unsigned>(std::clamp(log_of(sum) - unit_, 0, static_cast<int>(kContexts) - 1));
  }

  void add(std::int64_t magnitude) {
    std::int64_t& recent = recent_.data()[channel_];
    recent += (16 * magnitude - recent) >> 3;
    if (++channel_ == channels_) channel_ = 0;
    ++speed_;
  }

 private:
  /// 8 log2(x), piecewise linear between powers of two: exponent and three bits of a double. REQUIRES: 0 < x < 2^53.
  static int log_of(std::int64_t x) {
    static_assert(std::numeric_limits<double>::is_iec559);
    return static_cast<int>(std::bit_cast<std::uint64_t>(static_cast<double>(x)) >> 49) - (1023 << 3);
  }

  const std::uint32_t* speed_;
  unsigned channels_;
  int unit_;
  std::int64_t base_;
  std::array<std::int64_t, 16> recent_;  ///< By channel: exponential mean of magnitudes, in sixteenths.
  unsigned channel_ = 0;
};

/// A band's motion between the two keys before a coarse run.
struct Motion {
  explicit Motion(const References& from) : c1(from.c1), c2(from.c2.empty() ? from.c1 : from.c2), speeds(c1.size()) {
    for (std::size_t i = 0; i < c1.size(); ++i) {
      const std::int64_t speed = std::int64_t{c1[i]} - c2[i];
      speeds[i] = static_cast<std::uint32_t>(speed < 0 ? -speed : speed);
      speed_sum += speeds[i];
    }
  }
  unsigned expected_scale(unsigned half_spacing) const { return scale_code_of(speed_sum, speeds.size(), half_spacing); }
  /// Where a memory predicts better than speeds do, these count for less.
  void temper(unsigned expected, unsigned scale_code) {
    if (expected <= scale_code + 1) return;
    for (std::uint32_t& speed : speeds) speed >>= (expected - scale_code) / 2;
  }

  std::span<const std::int32_t> c1, c2;
  std::vector<std::uint32_t> speeds;
  std::uint64_t speed_sum = 0;
};

}  // namespace eigencast::band
