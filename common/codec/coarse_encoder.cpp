// SPDX-License-Identifier: MIT
//
// The encoder of coarse runs. Nothing here binds a decoder: another encoder may choose weights, scale and levels as it
// likes. All choices are made in integers, but for the weights, so that the bytes are the same on every machine.
#include <algorithm>
#include <cassert>
#include <cmath>

#include "common/codec/coarse_writer.h"

namespace eigencast::band {
namespace {

/// What levels 0 to 4 of a rule cost in a context, in 1/256 bit. From 2 on each level costs as much more than the one before.
using LevelCosts = std::array<std::int32_t, 5>;

/// By rule and context.
using CostTable = std::array<std::array<LevelCosts, kContexts>, 2>;

CostTable make_cost_table() {
  const DecisionCosts costs;
  CostTable table;
  for (const unsigned rule : {0u, 1u}) {
    for (unsigned context = 0; context < kContexts; ++context) {
      const LevelOdds odds(rule, context);
      const std::int32_t more_0 = costs.more[odds.beyond_0], more_1 = costs.more[odds.beyond_1];
      const std::int32_t two = 256 + more_0 + more_1 + costs.stop[odds.later], more = costs.more[odds.later];
      table[rule][context] = {costs.stop[odds.beyond_0], 256 + more_0 + costs.stop[odds.beyond_1], two, two + more,
                              two + 2 * more};
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

/// Viterbi's search for the levels of least distortion + lambda * rate. Contexts are those of the true residuals. Prices
/// are in 1/4096 of a squared step, less what all candidates of a value have in common, so that they fit 31 bits.
class Trellis {
 public:
  explicit Trellis(const Spacing& spacing)
      : m_(spacing.half), lambda_(4 * spacing.half * spacing.half * 15 / 16), spacings_(2 * m_) {}

  /// Writes the magnitudes of the levels.
  void search(std::span<const std::int64_t> residuals, ContextModel contexts, std::span<std::uint32_t> levels) const {
    constexpr std::int64_t kNever = std::int64_t{1} << 60;
    std::array<std::int64_t, 4> cost = {0, kNever, kNever, kNever};
    std::vector<Step> steps(residuals.size());
    Step* step = steps.data();
    for (const std::int64_t residual : residuals) {
      const std::int64_t x = residual < 0 ? -residual : residual;
      const unsigned context = contexts.next();
      contexts.add(x);
      const auto [at_0, at_1] = offers(x, context, *step);
      // Who leads where: kNextState, read backwards.
      const std::array<std::int64_t, 4> first = {cost[0] + at_0.even, cost[2] + at_1.even, cost[1] + at_0.even,
                                                 cost[3] + at_1.even};
      const std::array<std::int64_t, 4> second = {cost[1] + at_0.odd, cost[3] + at_1.odd, cost[0] + at_0.odd,
                                                  cost[2] + at_1.odd};
      for (unsigned state = 0; state < 4; ++state) {
        const std::int64_t gain = std::min<std::int64_t>(second[state] - first[state], 0);
        step->second[state] = gain < 0;
        cost[state] = first[state] + gain;
      }
      ++step;
    }
    trace_back(static_cast<unsigned>(std::min_element(cost.begin(), cost.end()) - cost.begin()), steps, levels);
  }

 private:
  struct Step {
    std::array<std::uint32_t, 2> low;  ///< By rule: the highest level whose point is not above the residual; m >= 1.
    std::array<bool, 2> zero;          ///< By rule: level 0 is the best even one, though it is not beside the residual.
    std::array<bool, 4> second;        ///< The path to each state came from the second of its two.
  };
  /// The prices of the best even and odd level of a rule.
  struct Offer {
    std::int32_t even, odd;
  };

  /// The offers of rules 0 and 1 for a residual of magnitude x.
  std::pair<Offer, Offer> offers(std::int64_t x, unsigned context, Step& step) const {
    const std::int64_t whole = spacings_(x);
    const auto rest = static_cast<std::int32_t>(x - whole * 2 * m_);
    const bool further = rest >= m_;
    step.low = {static_cast<std::uint32_t>(whole), static_cast<std::uint32_t>(whole + further)};
    // From level 2 on all cost alike.
    const auto low_0 = static_cast<unsigned>(std::min<std::int64_t>(whole, 2)), low_1 = low_0 + further;
    const std::int32_t to_0 = low_1 == 0 ? m_ : 0;  // Rule 1 has a point at 0, too, which is nearer than the others.
    const std::int32_t beyond_1 = rest + m_ - 2 * m_ * further - to_0;
    return {
        offer(costs_[0][context], low_0, rest, rest - 2 * m_, rest + 2 * m_, step.low[0], step.zero[0]),
        offer(costs_[1][context], low_1, beyond_1, beyond_1 - 2 * m_ + to_0, beyond_1 + m_, step.low[1], step.zero[1])};
  }

  /// low    the level whose point lies `beyond` before the residual, or as many levels below as cost alike
  /// below  what the residual lies beyond the next level's point
  /// all    the residual if low is 1
  Offer offer(const LevelCosts& costs, unsigned low, std::int32_t beyond, std::int32_t below, std::int32_t all,
              std::uint32_t true_low, bool& zero) const {
    const auto price = [&](std::int32_t error, unsigned level) {
      return error * error * 4096 + lambda_ * costs[level];
    };
    const std::int32_t price_low = price(beyond, low), price_high = price(below, low + 1), price_zero = price(all, 0);
    // Without branches: which level is odd is anybody's guess.
    const std::int32_t swap = (price_high - price_low) & -static_cast<std::int32_t>(true_low & 1);
    const std::int32_t even = price_low + swap,
                       gain = std::min(price_zero - even, 0) & -static_cast<std::int32_t>(low == 1);
    zero = gain < 0;
    return {even + gain, price_high - swap};
  }

  static void trace_back(unsigned state, std::span<const Step> steps, std::span<std::uint32_t> levels) {
    // state << 1 | parity of either origin.
    constexpr std::array<std::array<std::uint8_t, 2>, 4> kOrigins = {{{0, 3}, {4, 7}, {2, 1}, {6, 5}}};
    for (std::size_t i = steps.size(); i-- > 0;) {
      const unsigned origin = kOrigins[state][std::size_t{steps[i].second[state]}], parity = origin & 1;
      state = origin >> 1;
      const unsigned rule = rule_of(state);
      const std::uint32_t low = steps[i].low[rule];
      const bool zero = (parity == 0) & steps[i].zero[rule];
      levels[i] = (low + ((low & 1) ^ parity)) & (std::uint32_t{zero} - 1);
    }
  }

  std::int32_t m_;
  std::int32_t lambda_;  ///< 0.06 squared spacings a bit, as 1/4096 of a squared step for 1/256 bit.
  Quotient spacings_;
  const CostTable& costs_ = level_costs();
};

/// Writes the levels, and what they decode to; false if a value would leave the range.
bool put_levels(RangeEncoder& out, std::span<const std::int32_t> values, std::span<const std::int64_t> residuals,
                std::span<const std::uint32_t> levels, ContextModel contexts, const Spacing& spacing,
                std::span<std::int32_t> decoded) {
  unsigned state = 0;
  const std::int32_t* target = values.data();
  const std::int64_t* residual = residuals.data();
  std::int32_t* result = decoded.data();
  for (const std::uint32_t level : levels) {
    const unsigned rule = rule_of(state);
    const std::int64_t magnitude = point(rule, level) * spacing.half;
    const bool negative = *residual < 0;
    const std::int64_t value = *target++ - *residual++ + (negative ? -magnitude : magnitude);
    if (!fixed::in_range(value)) return false;
    *result++ = static_cast<std::int32_t>(value);
    put_level(out, level, LevelOdds(rule, contexts.next()));
    if (level > 0) out.put_even(negative);
    contexts.add(magnitude);
    state = kNextState[state][level & 1];
  }
  return true;
}

}  // namespace

bool append_coarse(std::span<const std::int32_t> values, const References& from, const Spacing& spacing, Bytes& out,
                   std::span<std::int32_t> decoded) {
  assert(spacing.half >= 1 && spacing.half <= kMaxHalfSpacing && from.c1.size() == values.size());
  const Motion motion(from);
  const Predictor predict = best_predictor(values, motion);
  std::vector<std::int64_t> residuals(values.size());
  std::uint64_t sum = 0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    residuals[i] = values[i] - predict(motion.c1[i], motion.c2[i]);
    sum += static_cast<std::uint64_t>(residuals[i] < 0 ? -residuals[i] : residuals[i]);
  }
  const unsigned scale = scale_code_of(sum, values.size(), spacing.half);
  const ContextModel contexts(motion.speeds, spacing, scale);
  std::vector<std::uint32_t> levels(values.size());
  Trellis(spacing).search(residuals, contexts, levels);

  const std::size_t begin = out.size();
  RangeEncoder encoder(out);
  put_scale(encoder, scale, motion.expected_scale(spacing.half));
  put_predictor(encoder, predict);
  if (!put_levels(encoder, values, residuals, levels, contexts, spacing, decoded)) {
    out.resize(begin);
    return false;
  }
  encoder.finish();
  return true;
}

}  // namespace eigencast::band
