// SPDX-License-Identifier: MIT
//
// The encoder of coarse runs. Nothing here binds a decoder: another encoder may choose weights, scale and levels as it
// likes. All choices are made in integers, but for the weights, so that the bytes are the same on every machine.
#include <algorithm>
#include <cassert>
#include <cmath>

#include "common/codec/coarse_model.h"
#include "common/codec/range_coder.h"

namespace eigencast::band {
namespace {

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

/// What levels of a rule cost in a context, in 1/256 bit.
struct LevelCosts {
  std::int32_t zero = 0, one = 0, two = 0, each_more = 0;

  std::int64_t of(std::int64_t level) const {
    return level >= 2 ? two + (level - 2) * each_more : level == 1 ? one : zero;
  }
};

/// By rule and context.
using CostTable = std::array<std::array<LevelCosts, kContexts>, 2>;

CostTable make_cost_table() {
  const DecisionCosts costs;
  CostTable table;
  for (const unsigned rule : {0u, 1u}) {
    for (unsigned context = 0; context < kContexts; ++context) {
      const LevelOdds odds(rule, context);
      const std::int32_t more_0 = costs.more[odds.beyond_0], more_1 = costs.more[odds.beyond_1];
      table[rule][context] = {costs.stop[odds.beyond_0], 256 + more_0 + costs.stop[odds.beyond_1],
                              256 + more_0 + more_1 + costs.stop[odds.later], costs.more[odds.later]};
    }
  }
  return table;
}

const CostTable& level_costs() {
  static const CostTable kTable = make_cost_table();
  return kTable;
}

/// What a restoring weight costs, as a share of the energy of one value: 4 bits buy 2 ln 2 each.
constexpr double kRestoringCost = 5.5;

/// The weights that leave the least energy, by least squares and then on their grid. A restoring weight is taken where it
/// gains what it costs.
Predictor best_predictor(std::span<const std::int32_t> values, const Motion& motion) {
  double vv = 0, vd = 0, vc = 0, dd = 0, dc = 0, cc = 0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    const auto c = static_cast<double>(motion.c1[i]);
    const double d = c - static_cast<double>(motion.c2[i]);
    const double v = static_cast<double>(values[i]) - c;
    vv += v * v, vd += v * d, vc += v * c, dd += d * d, dc += d * c, cc += c * c;
  }
  const auto on_grid = [](double weight, int unit, int zero) {
    return static_cast<unsigned>(std::clamp(std::floor(weight * unit) + zero, 0.0, 15.0));
  };
  struct Choice {
    Predictor predictor;
    double energy;
  };
  const auto consider = [&](Choice& best, unsigned speed, unsigned restoring) {
    const double w = (static_cast<double>(speed) - 4) / 8;
    const double a = (static_cast<double>(restoring) - kUsualRestoring) / 16;
    const double energy = vv + w * w * dd + 2 * w * a * dc + a * a * cc - 2 * w * vd - 2 * a * vc;
    if (energy < best.energy) best = {{speed, restoring}, energy};
  };
  const double determinant = dd * cc - dc * dc;
  const unsigned alone = on_grid(dd > 0 ? vd / dd : 0, 8, 4);
  const unsigned speed = on_grid(determinant > 0 ? (vd * cc - vc * dc) / determinant : 0, 8, 4);
  const unsigned restoring = on_grid(determinant > 0 ? (vc * dd - vd * dc) / determinant : 0, 16, kUsualRestoring);
  Choice usual{{}, vv}, best = usual;
  for (const unsigned one : {0u, 1u}) {
    consider(usual, std::min(alone + one, 15u), kUsualRestoring);
    for (const unsigned other : {0u, 1u}) consider(best, std::min(speed + one, 15u), std::min(restoring + other, 15u));
  }
  const auto count = static_cast<double>(values.size());
  return best.energy * (count + kRestoringCost) < usual.energy * count ? best.predictor : usual.predictor;
}

/// Viterbi's search for the levels of least distortion + lambda * rate. Contexts are those of the true residuals.
class Trellis {
 public:
  Trellis(std::span<const std::int64_t> residuals, const Spacing& spacing)
      : residuals_(residuals), m_(spacing.half), lambda_(4 * m_ * m_ * 15 / 16), steps_(residuals.size()) {}

  /// Magnitudes of the levels.
  void search(ContextModel contexts, std::vector<std::int64_t>& levels) {
    constexpr std::int64_t kNever = std::int64_t{1} << 60;
    std::array<std::int64_t, 4> cost = {0, kNever, kNever, kNever};
    for (std::size_t i = 0; i < residuals_.size(); ++i) {
      const std::int64_t x = residuals_[i] < 0 ? -residuals_[i] : residuals_[i];
      Step& step = steps_[i];
      std::array<std::array<std::int64_t, 2>, 2> price;
      offer(x, contexts.next(), step, price);
      contexts.add(x);
      const auto merge = [&](unsigned from, unsigned parity, unsigned other, unsigned other_parity) {
        const std::int64_t a = cost[from] + price[rule_of(from)][parity];
        const std::int64_t b = cost[other] + price[rule_of(other)][other_parity];
        const bool second = b < a;
        return std::pair(second ? b : a, second);
      };
      // Who leads where: kNextState, read backwards.
      const auto [c0, t0] = merge(0, 0, 1, 1);
      const auto [c1, t1] = merge(2, 0, 3, 1);
      const auto [c2, t2] = merge(1, 0, 0, 1);
      const auto [c3, t3] = merge(3, 0, 2, 1);
      cost = {c0, c1, c2, c3};
      step.second = {t0, t1, t2, t3};
    }
    trace_back(static_cast<unsigned>(std::min_element(cost.begin(), cost.end()) - cost.begin()), levels);
  }

 private:
  struct Step {
    std::array<std::array<std::int64_t, 2>, 2> level;  ///< The best of each rule and parity.
    std::array<bool, 4> second;                        ///< The path to each state came from the second of its two.
  };

  /// The cheapest level of each rule and parity, and its price in 1/4096 of a squared step.
  void offer(std::int64_t x, unsigned context, Step& step, std::array<std::array<std::int64_t, 2>, 2>& price) const {
    const std::int64_t spacing = 2 * m_;
    const std::int64_t below_0 = x < (std::int64_t{1} << 31)
                                     ? std::int64_t{static_cast<std::uint32_t>(x) / static_cast<std::uint32_t>(spacing)}
                                     : x / spacing;
    const std::array<std::int64_t, 2> below = {below_0, below_0 + (x - below_0 * spacing >= m_ ? 1 : 0)};
    for (const unsigned rule : {0u, 1u}) {
      const LevelCosts& costs = costs_[rule][context];
      const auto price_of = [&](std::int64_t level) {
        const std::int64_t error = x - point(rule, level) * m_;
        return error * error * 4096 + lambda_ * costs.of(level);
      };
      const std::int64_t low = below[rule];
      const auto parity = static_cast<unsigned>(low & 1);
      step.level[rule][parity] = low;
      price[rule][parity] = price_of(low);
      step.level[rule][parity ^ 1] = low + 1;
      price[rule][parity ^ 1] = price_of(low + 1);
      if (low != 1) continue;
      if (const std::int64_t zero = price_of(0); zero < price[rule][0]) {
        price[rule][0] = zero;
        step.level[rule][0] = 0;
      }
    }
  }

  void trace_back(unsigned state, std::vector<std::int64_t>& levels) const {
    struct Origin {
      std::uint8_t state, parity;
    };
    constexpr std::array<std::array<Origin, 2>, 4> kOrigins = {
        {{{{0, 0}, {1, 1}}}, {{{2, 0}, {3, 1}}}, {{{1, 0}, {0, 1}}}, {{{3, 0}, {2, 1}}}}};
    for (std::size_t i = steps_.size(); i-- > 0;) {
      const Origin origin = kOrigins[state][steps_[i].second[state] ? 1 : 0];
      levels[i] = steps_[i].level[rule_of(origin.state)][origin.parity];
      state = origin.state;
    }
  }

  std::span<const std::int64_t> residuals_;
  std::int64_t m_;
  std::int64_t lambda_;  ///< 0.06 squared spacings a bit, as 1/4096 of a squared step for 1/256 bit.
  std::vector<Step> steps_;
  const CostTable& costs_ = level_costs();
};

void put_escape(RangeEncoder& out, std::int64_t count) {
  const auto bits = static_cast<unsigned>(std::bit_width(static_cast<std::uint64_t>(count + 1))) - 1;
  for (unsigned i = 0; i < bits; ++i) out.put_even(true);
  if (bits < 31) out.put_even(false);
  for (unsigned i = bits; i-- > 0;) out.put_even(((count + 1) >> i & 1) != 0);
}

void put_bits(RangeEncoder& out, unsigned value, unsigned count) {
  while (count-- > 0) out.put_even((value >> count & 1) != 0);
}

void put_scale(RangeEncoder& out, unsigned scale, unsigned expected) {
  out.put(scale != expected, kScaleDiffers);
  if (scale == expected) return;
  out.put_even(scale < expected);
  const unsigned off = scale < expected ? expected - scale : scale - expected;
  for (unsigned reached = 1; reached <= off; ++reached) out.put(off > reached, kScaleFurther);
}

void put_predictor(RangeEncoder& out, const Predictor& predict) {
  put_bits(out, predict.speed, 4);
  out.put_even(predict.restoring != kUsualRestoring);
  if (predict.restoring != kUsualRestoring) put_bits(out, predict.restoring, 4);
}

void put_level(RangeEncoder& out, std::int64_t level, const LevelOdds& odds) {
  out.put(level > 0, kMore[odds.beyond_0]);
  if (level == 0) return;
  out.put(level > 1, kMore[odds.beyond_1]);
  for (std::int64_t reached = 2; reached <= level && reached < kMaxUnary; ++reached)
    out.put(level > reached, kMore[odds.later]);
  if (level >= kMaxUnary) put_escape(out, level - kMaxUnary);
}

}  // namespace

bool append_coarse(std::span<const std::int32_t> values, const References& from, const Spacing& spacing, Bytes& out,
                   std::span<std::int32_t> decoded) {
  assert(spacing.half >= 1 && spacing.half <= kMaxHalfSpacing && from.c1.size() == values.size());
  const Motion motion(from);
  const Predictor predict = best_predictor(values, motion);
  std::vector<std::int64_t> residuals(values.size()), levels(values.size());
  std::uint64_t sum = 0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    residuals[i] = values[i] - predict(motion.c1[i], motion.c2[i]);
    sum += static_cast<std::uint64_t>(residuals[i] < 0 ? -residuals[i] : residuals[i]);
  }
  const unsigned scale = scale_code_of(sum, values.size(), spacing.half);
  ContextModel contexts(motion.speeds, spacing, scale);
  Trellis(residuals, spacing).search(contexts, levels);

  unsigned state = 0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    const std::int64_t magnitude = point(rule_of(state), levels[i]) * spacing.half;
    const std::int64_t value = values[i] - residuals[i] + (residuals[i] < 0 ? -magnitude : magnitude);
    if (!fixed::in_range(value)) return false;
    state = kNextState[state][levels[i] & 1];
    decoded[i] = static_cast<std::int32_t>(value);
  }

  RangeEncoder encoder(out);
  put_scale(encoder, scale, motion.expected_scale(spacing.half));
  put_predictor(encoder, predict);
  state = 0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    const unsigned rule = rule_of(state);
    put_level(encoder, levels[i], LevelOdds(rule, contexts.next()));
    if (levels[i] > 0) encoder.put_even(residuals[i] < 0);
    contexts.add(point(rule, levels[i]) * spacing.half);
    state = kNextState[state][levels[i] & 1];
  }
  encoder.finish();
  return true;
}

}  // namespace eigencast::band
