// SPDX-License-Identifier: MIT
// All choices of append_coarse but the weights are made in integers, so that the bytes are the same on every machine.
// append_quick chooses each level alone, in 32-bit passes that the compiler vectorises.
#include <algorithm>
#include <array>
#include <bit>
#include <cassert>
#include <cmath>
#include <cstring>
#include <memory>

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

Moments<double> moments_of(std::span<const std::int32_t> values, const Motion& motion) {
  using Two = double __attribute__((vector_size(16)));
  const auto two = [](std::span<const std::int32_t> from, std::size_t i) {
    return Two{static_cast<double>(from[i]), static_cast<double>(from[i + 1])};
  };
  Moments<Two> pairs;
  const std::size_t whole = values.size() & ~std::size_t{1};
  for (std::size_t i = 0; i < whole; i += 2) {
    const Two c = two(motion.c1, i);
    pairs.add(two(values, i) - c, c - two(motion.c2, i), c);
  }
  const auto sum = [](Two of) { return of[0] + of[1]; };
  Moments<double> all{sum(pairs.vv), sum(pairs.vd), sum(pairs.vc), sum(pairs.dd), sum(pairs.dc), sum(pairs.cc)};
  if (whole < values.size()) {
    const double c = motion.c1[whole];
    all.add(values[whole] - c, c - motion.c2[whole], c);
  }
  return all;
}

/// The weights of least residual energy, by least squares, then on their grid; a restoring one only where it pays.
Predictor best_predictor(std::span<const std::int32_t> values, const Motion& motion) {
  const Moments<double> of = moments_of(values, motion);
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
    const double energy = of.vv + w * w * of.dd + 2 * w * a * of.dc + a * a * of.cc - 2 * w * of.vd - 2 * a * of.vc;
    if (energy < best.energy) best = {{speed, restoring}, energy};
  };
  const double determinant = of.dd * of.cc - of.dc * of.dc;
  const unsigned alone = on_grid(of.dd > 0 ? of.vd / of.dd : 0, 8, 4);
  const unsigned speed = on_grid(determinant > 0 ? (of.vd * of.cc - of.vc * of.dc) / determinant : 0, 8, 4);
  const unsigned restoring =
      on_grid(determinant > 0 ? (of.vc * of.dd - of.vd * of.dc) / determinant : 0, 16, kUsualRestoring);
  Choice usual{{}, of.vv}, best = usual;
  for (const unsigned one : {0u, 1u}) {
    consider(usual, std::min(alone + one, 15u), kUsualRestoring);
    for (const unsigned other : {0u, 1u}) consider(best, std::min(speed + one, 15u), std::min(restoring + other, 15u));
  }
  const auto count = static_cast<double>(values.size());
  return best.energy * (count + kRestoringCost) < usual.energy * count ? best.predictor : usual.predictor;
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

/// Values up to here, so that differences, weighted by up to 11, fit 31 bits.
constexpr std::uint32_t kMaxMagnitude = 1u << 24;

/// Price of a bit in squared spacings: higher than in the thorough search, since later levels' costs are ignored.
constexpr double kBitWorth = 0.09;

/// Residuals up to here become 0, by rule and context, in 1/256 of m.
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

bool append_coarse(std::span<const std::int32_t> values, const References& from, const Spacing& spacing, Bytes& out,
                   std::span<std::int32_t> decoded) {
  assert(spacing.half >= 1 && spacing.half <= kMaxHalfSpacing && from.c1.size() == values.size());
  const Motion motion(from);
  const Predictor predict = best_predictor(values, motion);
  const auto residuals = std::make_unique_for_overwrite<std::int64_t[]>(values.size());
  std::uint64_t sum = 0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    residuals[i] = values[i] - predict(motion.c1[i], motion.c2[i]);
    sum += static_cast<std::uint64_t>(residuals[i] < 0 ? -residuals[i] : residuals[i]);
  }
  const unsigned scale = scale_code_of(sum, values.size(), spacing.half);
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
  put_scale(encoder, scale, motion.expected_scale(spacing.half));
  put_predictor(encoder, predict);
  put_levels(encoder, {decisions.get(), values.size()});
  return true;
}

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
