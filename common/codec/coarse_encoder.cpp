// SPDX-License-Identifier: MIT
// All choices of append_coarse but the weights are made in integers, so that the bytes are the same on every machine.
#include <algorithm>
#include <array>
#include <bit>
#include <cassert>
#include <cmath>
#include <memory>
#include <numbers>
#include <vector>

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

inline void put_recalling(RangeEncoder& out, const RecallingPredictor& recall) {
  out.put_even(recall.hold != 0);
  if (recall.hold != 0) put_bits(out, recall.hold - 1, 2);
  out.put_even(recall.speed != kUsualSpeed);
  if (recall.speed != kUsualSpeed) put_bits(out, recall.speed, 4);
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

/// Costs of levels 0 to 4 of a rule in a context, in 1/256 bit. From 2 on the cost grows by the same amount per level.
using LevelCosts = std::array<std::int32_t, 5>;

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

/// Costs of levels as squared error: 0.06 squared spacings a bit, in 1/4096 of a squared step. Each thread keeps the
/// table that it used last, since m changes seldom.
const CostTable& prices_at(std::int32_t m) {
  struct Kept {
    std::int32_t m = 0;
    CostTable prices{};
  };
  thread_local Kept kept;
  if (kept.m == m) return kept.prices;
  const std::int32_t lambda = 4 * m * m * 15 / 16;  // For 1/256 bit.
  kept = {m, level_costs()};
  for (auto& rule : kept.prices) {
    for (LevelCosts& levels : rule) {
      for (std::int32_t& price : levels) price *= lambda;
    }
  }
  return kept.prices;
}

/// Cost of a restoring weight, relative to the energy of one value: 4 bits at 2 ln 2 each.
constexpr double kRestoringCost = 5.5;

/// Sums over a run of products of the movement v, the one before it d, and the pose c before the movement.
template <typename Number>
struct Moments {
  Number vv{}, vd{}, vc{}, dd{}, dc{}, cc{};

  void add(Number v, Number d, Number c) {
    vv += v * v, vd += v * d, vc += v * c, dd += d * d, dc += d * c, cc += c * c;
  }
};

/// Of `values` beyond `start`, of the movement c1 - c2, and of `other` beyond `origin`, which may be empty.
Moments<double> moments_of(std::span<const std::int32_t> values, std::span<const std::int32_t> start,
                           const References& keys, std::span<const std::int32_t> other,
                           std::span<const std::int32_t> origin) {
  using Two = double __attribute__((vector_size(16)));
  const auto two = [](std::span<const std::int32_t> from, std::size_t i) {
    return Two{static_cast<double>(from[i]), static_cast<double>(from[i + 1])};
  };
  Moments<Two> pairs;
  const std::size_t whole = values.size() & ~std::size_t{1};
  for (std::size_t i = 0; i < whole; i += 2) {
    const Two c = origin.empty() ? two(other, i) : two(other, i) - two(origin, i);
    pairs.add(two(values, i) - two(start, i), two(keys.c1, i) - two(keys.c2, i), c);
  }
  const auto sum = [](Two of) { return of[0] + of[1]; };
  Moments<double> all{sum(pairs.vv), sum(pairs.vd), sum(pairs.vc), sum(pairs.dd), sum(pairs.dc), sum(pairs.cc)};
  if (whole < values.size()) {
    const double c1 = keys.c1[whole], s = start[whole], c = other[whole] - (origin.empty() ? 0.0 : origin[whole]);
    all.add(values[whole] - s, c1 - keys.c2[whole], c);
  }
  return all;
}

/// The weight on the grid of 16 that is next below.
unsigned on_grid(double weight, int unit, int zero) {
  return static_cast<unsigned>(std::clamp(std::floor(weight * unit) + zero, 0.0, 15.0));
}

template <typename Weights>
struct Choice {
  Weights predictor;
  double energy;  ///< Of the residuals.
};

/// The weights of least residual energy, by least squares, then on their grid; a restoring one only where it pays.
Choice<Predictor> best_predictor(std::span<const std::int32_t> values, const References& keys) {
  const Moments<double> of = moments_of(values, keys.c1, keys, keys.c1, {});
  const auto consider = [&](Choice<Predictor>& best, unsigned speed, unsigned restoring) {
    const double w = (static_cast<double>(speed) - 4) / 8;
    const double a = (static_cast<double>(restoring) - kUsualRestoring) / 16;
    const double energy = of.vv + w * w * of.dd + 2 * w * a * of.dc + a * a * of.cc - 2 * w * of.vd - 2 * a * of.vc;
    if (energy < best.energy) best = {{speed, restoring}, energy};
  };
  const double determinant = of.dd * of.cc - of.dc * of.dc;
  const unsigned alone = on_grid(of.dd > 0 ? of.vd / of.dd : 0, 8, 4);
  const unsigned speed = on_grid(determinant > 0 ? (of.vd * of.cc - of.vc * of.dc) / determinant : 0, 8, 4);
  const unsigned restoring =
      on_grid(determinant > 0 ? (of.vc * of.dd - of.vd * of.dc) / determinant : 0, 16, kUsualRestoring);
  Choice<Predictor> usual{{}, of.vv}, best = usual;
  for (const unsigned one : {0u, 1u}) {
    consider(usual, std::min(alone + one, 15u), kUsualRestoring);
    for (const unsigned other : {0u, 1u}) consider(best, std::min(speed + one, 15u), std::min(restoring + other, 15u));
  }
  const auto count = static_cast<double>(values.size());
  return best.energy * (count + kRestoringCost) < usual.energy * count ? best : usual;
}

/// What quantising leaves of a value is at least so much energy, in squared half spacings.
constexpr double kLeastEnergy = 0.5;

/// The same with a memory: weights other than 0 only where they pay.
Choice<RecallingPredictor> best_recalling(std::span<const std::int32_t> values, const References& from, unsigned half) {
  const Moments<double> of = moments_of(values, from.e, from, from.c1, from.e1);
  const auto count = static_cast<double>(values.size());
  const double least = kLeastEnergy * half * half * count;
  Choice<RecallingPredictor> best{{}, of.vv};
  double best_cost = (of.vv + least) * count;
  const auto consider = [&](unsigned hold, unsigned speed) {
    const double q = hold * 0.25, w = (static_cast<double>(speed) - kUsualSpeed) / 8;
    const double energy = of.vv + w * w * of.dd + 2 * w * q * of.dc + q * q * of.cc - 2 * w * of.vd - 2 * q * of.vc;
    const int bits = (hold == 0 ? 0 : 2) + (speed == kUsualSpeed ? 0 : 4);
    const double cost = (energy + least) * (count + 2 * std::numbers::ln2 * bits);
    if (cost < best_cost) best = {{hold, speed}, energy}, best_cost = cost;
  };
  for (unsigned hold = 0; hold <= 4; ++hold) {
    const unsigned speed = on_grid(of.dd > 0 ? (of.vd - hold * 0.25 * of.dc) / of.dd : 0, 8, 4);
    for (const unsigned s : {kUsualSpeed, speed, std::min(speed + 1, 15u)}) consider(hold, s);
  }
  return best;
}

using Four = std::int32_t __attribute__((vector_size(16)));

/// Viterbi's search for the levels of least distortion + lambda * rate. Prices are in 1/4096 of a squared step, without
/// the part common to all candidates of a value, so that they stay within 2^29. Costs are relative to the first
/// state's; they differ by at most two prices.
class Trellis {
 public:
  explicit Trellis(const Spacing& spacing)
      : m_(spacing.half), square_(4096 * m_ * m_), spacings_(2 * m_), prices_(prices_at(m_)) {}

  /// Writes the magnitudes of the levels. `contexts` are those of the true residuals.
  void search(std::span<const std::int64_t> residuals, const std::uint8_t* contexts, std::uint32_t* levels) const {
    constexpr std::int32_t kNever = 1 << 30;
    // kNextState reversed, as state << 1 | parity: each state's predecessor by an even level, and by an odd one.
    constexpr Four kEven = {0, 4, 2, 6}, kOdd = {3, 7, 1, 5};
    Four cost = {0, kNever, kNever, kNever};
    const auto steps = std::make_unique_for_overwrite<Step[]>(residuals.size());
    Step* step = steps.get();
    for (const std::int64_t residual : residuals) {
      const Four offer = offers(residual < 0 ? -residual : residual, *contexts++, *step);
      const Four even =
          __builtin_shufflevector(cost, cost, 0, 2, 1, 3) + __builtin_shufflevector(offer, offer, 0, 2, 0, 2);
      const Four odd =
          __builtin_shufflevector(cost, cost, 1, 3, 0, 2) + __builtin_shufflevector(offer, offer, 1, 3, 1, 3);
      step->origin = odd < even ? kOdd : kEven;
      cost = odd < even ? odd : even;
      cost -= __builtin_shufflevector(cost, cost, 0, 0, 0, 0);
      ++step;
    }
    unsigned best = 0;
    for (unsigned state = 1; state < 4; ++state) {
      if (cost[state] < cost[best]) best = state;
    }
    trace_back(best, steps.get(), residuals.size(), levels);
  }

 private:
  struct Step {
    Four origin;                       ///< By state: the predecessor of its path, and the parity.
    std::array<std::uint32_t, 2> low;  ///< By rule: the highest level whose point is not above the residual; m >= 1.
    std::array<bool, 2> zero;          ///< By rule: level 0 is the best even one, though not next to the residual.
  };
  struct Offer {
    std::int32_t even, odd;
  };

  /// The even and odd offers of rules 0 and 1 for a residual of magnitude x.
  Four offers(std::int64_t x, unsigned context, Step& step) const {
    const std::int64_t whole = spacings_(x);
    const auto rest = static_cast<std::int32_t>(x - whole * 2 * m_);
    const bool further = rest >= m_;
    step.low = {static_cast<std::uint32_t>(whole), static_cast<std::uint32_t>(whole + further)};
    // From level 2 on all cost alike.
    const auto low_0 = static_cast<unsigned>(std::min<std::int64_t>(whole, 2)), low_1 = low_0 + further;
    // A point at distance rest + k m has the distortion k^2 m^2 + 2 k m rest, plus the common rest^2. Masks instead of
    // branches, which would be mispredicted.
    const std::int32_t slope = 8192 * m_ * rest, to_zero = 4 * square_ + 2 * slope;
    const std::int32_t if_further = -std::int32_t{further};
    const Offer rule_0 =
        offer(0, 4 * square_ - 2 * slope, to_zero, prices_[0].data()[context].data(), low_0, step.low[0], step.zero[0]);
    // Rule 1 also has a point at 0, nearer than the others.
    const std::int32_t below = (square_ + slope - (2 * slope & if_further)) & -std::int32_t{low_1 != 0};
    const std::int32_t above = square_ - slope + ((8 * square_ - 2 * slope) & if_further);
    const Offer rule_1 =
        offer(below, above, to_zero & ~if_further, prices_[1].data()[context].data(), low_1, step.low[1], step.zero[1]);
    return Four{rule_0.even, rule_0.odd, rule_1.even, rule_1.odd};
  }

  /// The better even and odd level of `low`, low + 1 and 0, from their distortions.
  ///   low  capped at 2, since further levels cost alike
  static Offer offer(std::int32_t below, std::int32_t above, std::int32_t to_zero, const std::int32_t* prices,
                     unsigned low, std::uint32_t true_low, bool& zero) {
    const std::int32_t price_low = below + prices[low], price_high = above + prices[low + 1];
    const std::int32_t swap = (price_high - price_low) & -static_cast<std::int32_t>(true_low & 1);
    const std::int32_t even = price_low + swap,
                       gain = std::min(to_zero + prices[0] - even, 0) & -static_cast<std::int32_t>(low == 1);
    zero = gain < 0;
    return {even + gain, price_high - swap};
  }

  static void trace_back(unsigned state, const Step* steps, std::size_t count, std::uint32_t* levels) {
    for (std::size_t i = count; i-- > 0;) {
      const auto origin = static_cast<unsigned>(steps[i].origin[state]), parity = origin & 1;
      state = origin >> 1;
      const unsigned rule = rule_of(state);
      const std::uint32_t low = steps[i].low.data()[rule];
      const bool zero = (parity == 0) & steps[i].zero.data()[rule];
      levels[i] = (low + ((low & 1) ^ parity)) & (std::uint32_t{zero} - 1);
    }
  }

  std::int32_t m_;
  std::int32_t square_;  ///< m^2, as a price.
  Quotient spacings_;
  const CostTable& prices_;
};

struct Decision {
  std::uint32_t level;
  std::uint8_t rule, context;
  bool negative;
};

/// Decodes the levels and prepares their coding; false if a value would leave the range.
bool decide(std::span<const std::int32_t> values, const std::int64_t* residual, const std::uint32_t* level,
            ContextModel contexts, std::int64_t m, Decision* decision, std::int32_t* decoded) {
  unsigned state = 0;
  bool in_range = true;
  for (const std::int32_t target : values) {
    const unsigned rule = rule_of(state);
    const std::int64_t magnitude = point(rule, *level) * m;
    const bool negative = *residual < 0;
    const std::int64_t value = target - *residual++ + (negative ? -magnitude : magnitude);
    in_range &= fixed::in_range(value);
    *decoded++ = static_cast<std::int32_t>(value);
    *decision++ = {*level, static_cast<std::uint8_t>(rule), static_cast<std::uint8_t>(contexts.next()), negative};
    contexts.add(magnitude);
    state = kNextState.data()[state].data()[*level++ & 1];
  }
  return in_range;
}

void put_levels(RangeEncoder out, std::span<const Decision> decisions) {
  for (const Decision& d : decisions) {
    put_level(out, d.level, LevelOdds(d.rule, d.context));
    if (d.level > 0) out.put_even(d.negative);
  }
  out.finish();
}

/// Codes each value at a level whose point is within m of it.
void put_nearest_levels(RangeEncoder out, std::span<const std::int32_t> values, std::span<const std::int32_t> from,
                        ContextModel contexts, std::int64_t m) {
  const Quotient spacings(2 * m);
  unsigned state = 0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    const std::int64_t residual = std::int64_t{values[i]} - from[i], x = std::abs(residual);
    const unsigned rule = rule_of(state);
    const std::int64_t level = x <= m ? 0 : spacings(x + m * (1 + std::int64_t{rule}));
    put_level(out, level, LevelOdds(rule, contexts.next()));
    if (level > 0) out.put_even(residual < 0);
    contexts.add(point(rule, level) * m);
    state = kNextState[state][level & 1];
  }
  out.finish();
}

}  // namespace

bool append_coarse(std::span<const std::int32_t> values, const References& keys, const Spacing& spacing, Bytes& out,
                   std::span<std::int32_t> decoded) {
  assert(spacing.half >= 1 && spacing.half <= kMaxHalfSpacing && keys.c1.size() == values.size());
  const References from = completed(keys);
  Motion motion(from);
  Predictor predict;
  RecallingPredictor recall;
  if (from.e.empty()) {
    predict = best_predictor(values, from).predictor;
  } else {
    recall = best_recalling(values, from, spacing.half).predictor;
  }
  const Prediction predicted = from.e.empty() ? Prediction(from, predict) : Prediction(from, recall);
  const auto residuals = std::make_unique_for_overwrite<std::int64_t[]>(values.size());
  std::uint64_t sum = 0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    residuals[i] = values[i] - predicted(i);
    sum += static_cast<std::uint64_t>(residuals[i] < 0 ? -residuals[i] : residuals[i]);
  }
  const unsigned scale = scale_code_of(sum, values.size(), spacing.half);
  const unsigned expected = motion.expected_scale(spacing.half);
  if (!from.e.empty()) motion.temper(expected, scale);
  const ContextModel first(motion.speeds, spacing, scale);
  const auto contexts = std::make_unique_for_overwrite<std::uint8_t[]>(values.size());
  ContextModel model = first;
  for (std::size_t i = 0; i < values.size(); ++i) {
    contexts[i] = static_cast<std::uint8_t>(model.next());
    model.add(std::abs(residuals[i]));
  }
  const auto levels = std::make_unique_for_overwrite<std::uint32_t[]>(values.size());
  Trellis(spacing).search({residuals.get(), values.size()}, contexts.get(), levels.get());
  const auto decisions = std::make_unique_for_overwrite<Decision[]>(values.size());
  if (!decide(values, residuals.get(), levels.get(), first, spacing.half, decisions.get(), decoded.data()))
    return false;

  RangeEncoder encoder(out);
  put_scale(encoder, scale, from.e.empty() ? expected : std::min(expected, kRecalledScale));
  from.e.empty() ? put_predictor(encoder, predict) : put_recalling(encoder, recall);
  put_levels(encoder, {decisions.get(), values.size()});
  return true;
}

double estimated_bits(std::span<const std::int32_t> values, const References& keys, const Spacing& spacing) {
  const References from = completed(keys);
  const double energy =
      from.e.empty() ? best_predictor(values, from).energy : best_recalling(values, from, spacing.half).energy;
  const auto count = static_cast<double>(values.size());
  return count / 2 * std::log2(std::max(energy, 0.0) / count + kLeastEnergy * spacing.half * spacing.half);
}

bool append_nearest(std::span<const std::int32_t> values, std::span<const std::int32_t> from, const Spacing& spacing,
                    Bytes& out) {
  assert(spacing.half >= 1 && spacing.half <= kMaxHalfSpacing && from.size() == values.size());
  std::uint64_t sum = 0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (std::abs(std::int64_t{values[i]}) > fixed::kMaxValue - spacing.half) return false;
    sum += static_cast<std::uint64_t>(std::abs(std::int64_t{values[i]} - from[i]));
  }
  const std::vector<std::uint32_t> still(values.size());
  const unsigned scale = scale_code_of(sum, values.size(), spacing.half);
  RangeEncoder encoder(out);
  put_scale(encoder, scale, scale_code_of(0, values.size(), spacing.half));
  put_predictor(encoder, Predictor{});
  put_nearest_levels(encoder, values, from, ContextModel(still, spacing, scale), spacing.half);
  return true;
}

}  // namespace eigencast::band
