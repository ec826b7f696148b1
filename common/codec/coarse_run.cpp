// SPDX-License-Identifier: MIT
#include <algorithm>
#include <string>

#include "common/codec/coarse_model.h"
#include "common/codec/range_coder.h"

namespace eigencast::band {
namespace {

constexpr std::array<std::uint16_t, kContexts + kLowestOffset> more_table() {
  constexpr std::size_t kFirst = 59 + kLowestOffset;  // Below it the curve is under 64, above it over 2^15 - 64.
  constexpr std::array<std::uint16_t, 93> kCurve = {
      97,    158,   238,   339,   460,   600,   936,   1336,  1787,  2277,  2795,  3333,  3881,  4435,  5538,  6616,
      7652,  8638,  9570,  10450, 11277, 12055, 13471, 14724, 15834, 16824, 17709, 18505, 19223, 19875, 21010, 21965,
      22778, 23479, 24089, 24624, 25098, 25520, 26239, 26828, 27320, 27738, 28095, 28406, 28678, 28918, 29322, 29650,
      29920, 30148, 30342, 30509, 30655, 30783, 30997, 31170, 31312, 31431, 31532, 31618, 31694, 31760, 31870, 31959,
      32032, 32092, 32144, 32188, 32226, 32260, 32316, 32361, 32398, 32428, 32454, 32477, 32496, 32513, 32541, 32564,
      32582, 32598, 32611, 32622, 32632, 32640, 32654, 32666, 32675, 32683, 32689, 32695, 32700};
  std::array<std::uint16_t, kContexts + kLowestOffset> table{};
  for (std::size_t i = 0; i < table.size(); ++i) {
    table[i] = i < kFirst ? 64 : i < kFirst + kCurve.size() ? kCurve[i - kFirst] : (1u << kProbabilityBits) - 64;
  }
  return table;
}

Error corrupt(std::string what) {
  return fail(ErrorCode::kCorrupt, std::move(what));
}

/// Exp-Golomb: the bits after the highest of count + 1, behind as many ones and a zero. A hostile one ends at 2^31.
std::int64_t read_escape(RangeDecoder& in) {
  unsigned bits = 0;
  while (bits < 31 && in.get_even()) ++bits;
  std::int64_t value = 1;
  for (unsigned i = 0; i < bits; ++i) value = value << 1 | static_cast<std::int64_t>(in.get_even());
  return value - 1;
}

unsigned read_bits(RangeDecoder& in, unsigned count) {
  unsigned value = 0;
  while (count-- > 0) value = value << 1 | static_cast<unsigned>(in.get_even());
  return value;
}

/// The result may be out of range.
int read_scale(RangeDecoder& in, unsigned expected) {
  if (!in.get(kScaleDiffers)) return static_cast<int>(expected);
  const bool less = in.get_even();
  int off = 1;
  while (off <= static_cast<int>(kMaxScaleCode) && in.get(kScaleFurther)) ++off;
  return static_cast<int>(expected) + (less ? -off : off);
}

Predictor read_predictor(RangeDecoder& in) {
  Predictor predict{read_bits(in, 4)};
  if (in.get_even()) predict.restoring = read_bits(in, 4);
  return predict;
}

std::int64_t read_level(RangeDecoder& in, const LevelOdds& odds) {
  if (!in.get(kMore[odds.beyond_0])) return 0;
  if (!in.get(kMore[odds.beyond_1])) return 1;
  std::int64_t level = 2;
  while (level < kMaxUnary && in.get(kMore[odds.later])) ++level;
  return level < kMaxUnary ? level : level + read_escape(in);
}

RecallingPredictor read_recalling(RangeDecoder& in) {
  RecallingPredictor recall;
  if (in.get_even()) recall.hold = 1 + read_bits(in, 2);
  if (in.get_even()) recall.speed = read_bits(in, 4);
  return recall;
}

}  // namespace

constexpr std::array<std::uint16_t, kContexts + kLowestOffset> kMore = more_table();

Result<std::size_t> read_coarse(ByteView in, const References& keys, const Spacing& spacing,
                                std::span<std::int32_t> values) {
  if (spacing.half == 0) return corrupt("a coarse run in a frame that has no spacing");
  if (keys.c1.empty()) return corrupt("a coarse run needs a key that the receiver lacks");
  const References from = completed(keys);
  const bool recalls = !from.e.empty();
  Motion motion(from);
  RangeDecoder decoder(in);
  const unsigned expected = motion.expected_scale(spacing.half);
  const int scale = read_scale(decoder, recalls ? std::min(expected, kRecalledScale) : expected);
  if (scale < 0 || scale > static_cast<int>(kMaxScaleCode)) return corrupt("its scale is out of range");
  const Prediction predicted =
      recalls ? Prediction(from, read_recalling(decoder)) : Prediction(from, read_predictor(decoder));
  if (recalls) motion.temper(expected, static_cast<unsigned>(scale));
  ContextModel contexts(motion.speeds, spacing, static_cast<unsigned>(scale));
  unsigned state = 0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    const unsigned rule = rule_of(state);
    const std::int64_t level = read_level(decoder, LevelOdds(rule, contexts.next()));
    const std::int64_t residual = point(rule, level) * spacing.half;
    const bool negative = level > 0 && decoder.get_even();
    const std::int64_t value = predicted(i) + (negative ? -residual : residual);
    if (!fixed::in_range(value)) return corrupt("a value leaves +-2^30");
    values[i] = static_cast<std::int32_t>(value);
    contexts.add(residual);
    state = kNextState[state][level & 1];
  }
  if (!decoder.finished()) return corrupt("bytes are left over");
  return in.size();
}

}  // namespace eigencast::band
