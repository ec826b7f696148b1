// SPDX-License-Identifier: MIT
// append_quick: chooses each level alone, in 32-bit passes that the compiler vectorises.
#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <cstring>

#include "common/codec/coarse_writer.h"

namespace eigencast::band {
namespace {

/// Values up to here, so that differences, weighted by up to 11, fit 31 bits.
constexpr std::uint32_t kMaxMagnitude = 1u << 24;

/// Price of a bit in squared spacings: higher than in the thorough search, since later levels' costs are ignored.
constexpr double kBitWorth = 0.09;

/// By rule and context, in 1/256 of m: residuals up to here become 0.
using ZeroZones = std::array<std::array<std::uint16_t, kContexts>, 2>;

ZeroZones make_zero_zones() {
  const DecisionCosts costs;
  ZeroZones zones;
  for (const unsigned rule : {0u, 1u}) {
    const double first = rule == 0 ? 2 : 1;  // Where level 1 lies, in m.
    for (unsigned context = 0; context < kContexts; ++context) {
      const LevelOdds odds(rule, context);
      const double bits =
          (256.0 + costs.more[odds.beyond_0] + costs.stop[odds.beyond_1] - costs.stop[odds.beyond_0]) / 256;
      // x^2 = (x - first)^2 + worth of the bits.
      const double limit = (first * first + 4 * kBitWorth * bits) / (2 * first);
      zones[rule][context] = static_cast<std::uint16_t>(std::lround(256 * std::clamp(limit, 0.0, 3.0)));
    }
  }
  return zones;
}

const ZeroZones& zero_zones() {
  static const ZeroZones kZones = make_zero_zones();
  return kZones;
}

bool all_small(std::span<const std::int32_t> values) {
  std::uint32_t seen = 0;
  for (const std::int32_t value : values) seen |= static_cast<std::uint32_t>(value ^ (value >> 31));
  return seen < kMaxMagnitude;
}

/// The weight of c1 - c2 of least residual energy, by least squares, then on its grid.
Predictor best_speed(std::span<const std::int32_t> values, const std::int32_t* c1, const std::int32_t* c2) {
  // Several sums at a time, in doubles, in a fixed order.
  using TwoInts = std::int32_t __attribute__((vector_size(8)));
  using Two = double __attribute__((vector_size(16)));
  constexpr std::size_t kLanes = 4;
  const auto two = [](const std::int32_t* from) {
    TwoInts ints;
    std::memcpy(&ints, from, sizeof ints);
    return __builtin_convertvector(ints, Two);
  };
  std::array<Two, 2> vds{}, dds{};
  const std::int32_t* v = values.data();
  const std::size_t whole = values.size() / kLanes * kLanes;
  for (std::size_t i = 0; i < whole; i += kLanes) {
    for (std::size_t half : {0u, 1u}) {
      const Two c = two(c1 + i + 2 * half), d = c - two(c2 + i + 2 * half), moved = two(v + i + 2 * half) - c;
      vds.data()[half] += moved * d, dds.data()[half] += d * d;
    }
  }
  for (std::size_t i = whole; i < values.size(); ++i) {
    const double d = c1[i] - c2[i];
    vds[0][0] += (v[i] - c1[i]) * d, dds[0][0] += d * d;
  }
  const double vd = (vds[0][0] + vds[0][1]) + (vds[1][0] + vds[1][1]);
  const double dd = (dds[0][0] + dds[0][1]) + (dds[1][0] + dds[1][1]);
  const double weight = dd > 0 ? std::floor(8 * vd / dd + 0.5) + 4 : 4;
  return {static_cast<unsigned>(std::clamp(weight, 0.0, 15.0)), kUsualRestoring};
}

struct Sums {
  std::uint64_t speeds = 0, residuals = 0;
};

/// Writes |c1 - c2| and the residual of each value.
Sums predict_all(std::span<const std::int32_t> values, const std::int32_t* c1, const std::int32_t* c2,
                 const Predictor& predict, std::uint32_t* speeds, std::int32_t* residuals) {
  const std::int32_t weight = static_cast<std::int32_t>(predict.speed) - 4;
  const std::int32_t* v = values.data();
  Sums sums;
  for (std::size_t i = 0; i < values.size(); ++i) {
    const std::int32_t d = c1[i] - c2[i], residual = v[i] - c1[i] - ((weight * d + 4) >> 3);
    residuals[i] = residual;
    speeds[i] = static_cast<std::uint32_t>(std::abs(d));
    sums.speeds += speeds[i];
    sums.residuals += static_cast<std::uint32_t>(std::abs(residual));
  }
  return sums;
}

void put_quick_levels(RangeEncoder out, std::span<const std::int32_t> residuals, ContextModel contexts,
                      std::int32_t m) {
  const ZeroZones& zones = zero_zones();
  const Quotient spacings(2 * std::int64_t{m});
  unsigned state = 0;
  for (const std::int32_t residual : residuals) {
    const unsigned rule = rule_of(state), context = contexts.next();
    const std::int64_t x = std::abs(residual);
    const LevelOdds odds(rule, context);
    if (x << 8 <= std::int64_t{zones[rule][context]} * m) {
      out.put(false, kMore[odds.beyond_0]);
      contexts.add(0);
      state = kNextState[state][0];
      continue;
    }
    const std::int64_t level = std::max<std::int64_t>(1, spacings(x + (m * (14 + 16 * rule) >> 4)));
    put_level(out, level, odds);
    out.put_even(residual < 0);
    contexts.add(point(rule, level) * m);
    state = kNextState[state][level & 1];
  }
  out.finish();
}

}  // namespace

bool append_quick(std::span<const std::int32_t> values, std::span<const std::int32_t> c1,
                  std::span<const std::int32_t> c2, const Spacing& spacing, QuickWorkspace& workspace, Bytes& out) {
  assert(spacing.half >= 1 && spacing.half <= kMaxHalfSpacing && c1.size() == values.size() && c2.size() == c1.size());
  if (!all_small(values) || !all_small(c1) || !all_small(c2)) return false;
  const Predictor predict = best_speed(values, c1.data(), c2.data());
  workspace.speeds.resize(values.size());
  workspace.residuals.resize(values.size());
  const Sums sums =
      predict_all(values, c1.data(), c2.data(), predict, workspace.speeds.data(), workspace.residuals.data());
  const unsigned scale = scale_code_of(sums.residuals, values.size(), spacing.half);
  RangeEncoder encoder(out);
  put_scale(encoder, scale, scale_code_of(sums.speeds, values.size(), spacing.half));
  put_predictor(encoder, predict);
  put_quick_levels(encoder, workspace.residuals, ContextModel(workspace.speeds, spacing, scale), spacing.half);
  return true;
}

}  // namespace eigencast::band
