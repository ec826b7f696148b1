// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <bit>
#include <cmath>
#include <cstdint>

#include "common/codec/coarse_model.h"
#include "common/codec/range_coder.h"

/// Shared by both encoders of coarse runs.
namespace eigencast::band {

/// Cost of a decision in 1/256 bit, by index into kMore.
struct DecisionCosts {
  std::array<std::uint16_t, kMore.size()> more{}, stop{};
  DecisionCosts() {
    for (std::size_t i = 0; i < kMore.size(); ++i) {
      more[i] = static_cast<std::uint16_t>(std::lround(256 * (15 - std::log2(kMore[i]))));
      stop[i] = static_cast<std::uint16_t>(std::lround(256 * (15 - std::log2(32768 - kMore[i]))));
    }
  }
};

/// x / divisor: by a multiplication for x < 2^24 (divisors are at most 126), by a division beyond.
class Quotient {
 public:
  explicit Quotient(std::int64_t divisor)
      : divisor_(divisor), inverse_(((std::int64_t{1} << 32) + divisor - 1) / divisor) {}
  std::int64_t operator()(std::int64_t x) const { return x < 1 << 24 ? x * inverse_ >> 32 : x / divisor_; }

 private:
  std::int64_t divisor_, inverse_;
};

inline void put_escape(RangeEncoder& out, std::int64_t count) {
  const auto bits = static_cast<unsigned>(std::bit_width(static_cast<std::uint64_t>(count + 1))) - 1;
  for (unsigned i = 0; i < bits; ++i) out.put_even(true);
  if (bits < 31) out.put_even(false);
  for (unsigned i = bits; i-- > 0;) out.put_even(((count + 1) >> i & 1) != 0);
}

inline void put_bits(RangeEncoder& out, unsigned value, unsigned count) {
  while (count-- > 0) out.put_even((value >> count & 1) != 0);
}

inline void put_scale(RangeEncoder& out, unsigned scale, unsigned expected) {
  out.put(scale != expected, kScaleDiffers);
  if (scale == expected) return;
  out.put_even(scale < expected);
  const unsigned off = scale < expected ? expected - scale : scale - expected;
  for (unsigned reached = 1; reached <= off; ++reached) out.put(off > reached, kScaleFurther);
}

inline void put_predictor(RangeEncoder& out, const Predictor& predict) {
  put_bits(out, predict.speed, 4);
  out.put_even(predict.restoring != kUsualRestoring);
  if (predict.restoring != kUsualRestoring) put_bits(out, predict.restoring, 4);
}

inline void put_level(RangeEncoder& out, std::int64_t level, const LevelOdds& odds) {
  const std::uint16_t* more = kMore.data();
  out.put(level > 0, more[odds.beyond_0]);
  if (level == 0) return;
  out.put(level > 1, more[odds.beyond_1]);
  for (std::int64_t reached = 2; reached <= level && reached < kMaxUnary; ++reached)
    out.put(level > reached, more[odds.later]);
  if (level >= kMaxUnary) put_escape(out, level - kMaxUnary);
}

}  // namespace eigencast::band
