// SPDX-License-Identifier: MIT
#include "common/levels/lod_resolver.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <random>

#include "client/meters.h"

namespace eigencast {
namespace {

using Counts = std::vector<std::uint32_t>;

double cost_of(const std::vector<ObjectView>& objects, const Counts& n) {
  double cost = 0;
  for (std::size_t i = 0; i < n.size(); ++i) cost += objects[i].vertex_cost * n[i];
  return cost;
}

double error_of(const std::vector<ObjectView>& objects, const std::vector<double>& n) {
  double error = 0;
  for (std::size_t i = 0; i < n.size(); ++i) error += objects[i].pixels * objects[i].pixels / n[i];
  return error;
}

TEST(PaperLevel, IsEquation5And6) {
  EXPECT_DOUBLE_EQ(PaperResolver::level(0.25, 0), 0.75);
  EXPECT_DOUBLE_EQ(PaperResolver::level(0.25, 0.4), 0.75 + 0.4 * 0.25);
  EXPECT_DOUBLE_EQ(PaperResolver::level(0.25, -0.4), 0.75 - 0.4 * 0.75);
  for (const double scaled : {0.0, 0.3, 1.0}) {
    EXPECT_DOUBLE_EQ(PaperResolver::level(scaled, 1), 1) << "kappa = 1 is full detail everywhere";
    EXPECT_DOUBLE_EQ(PaperResolver::level(scaled, -1), 0) << "kappa = -1 is the floor everywhere";
  }
}

TEST(PaperResolver, MovesKappaByDeltaPerInterval) {
  PaperResolver resolver({});
  const std::vector<ObjectView> objects{{1000, 10, 0.5, 100, 1}};
  TimeUs now = 0;
  const auto run = [&](double seconds, int frames) {
    for (int i = 0; i < frames; ++i) {
      now += 10'000;
      resolver.resolve(objects, FrameWork{now, seconds});
    }
  };
  run(1.0 / 20, 101);
  EXPECT_DOUBLE_EQ(resolver.state(), 0) << "f = f0";
  run(1.0 / 16, 100);
  EXPECT_NEAR(resolver.state(), -0.10, 1e-12) << "ten intervals below f0 - T_f";
  run(1.0 / 24, 50);
  EXPECT_NEAR(resolver.state(), -0.05, 1e-12);
  run(1.0 / 100, 5000);
  EXPECT_DOUBLE_EQ(resolver.state(), 1) << "bounded above";
  run(1.0, 5000);
  EXPECT_DOUBLE_EQ(resolver.state(), -1) << "bounded below";
  EXPECT_EQ(resolver.resolve(objects, std::nullopt), Counts{10}) << "never below the least";
}

TEST(SplitBudget, SpendsTheBudgetAndNoMore) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> pixels(0, 900), cost(0.2, 5);
  std::uniform_int_distribution<std::uint32_t> size(500, 60'000);
  for (int round = 0; round < 200; ++round) {
    std::vector<ObjectView> objects;
    double least = 0, most = 0;
    for (int i = 0; i < 8; ++i) {
      const std::uint32_t n = size(random);
      objects.push_back({n, n / 100, 1, i == 3 ? 0 : pixels(random), cost(random)});
      least += objects.back().vertex_cost * objects.back().min;
      if (objects.back().pixels > 0) most += objects.back().vertex_cost * n;
    }
    const double budget = std::uniform_real_distribution<double>(least, most)(random);
    const Counts n = split_budget(objects, budget);
    EXPECT_LE(cost_of(objects, n), budget + 1e-6);
    double rounding = 0;
    for (const auto& object : objects) rounding += object.vertex_cost;
    if (budget < most * 0.99) {
      EXPECT_GE(cost_of(objects, n), budget - rounding);
    }
    EXPECT_EQ(n[3], objects[3].min) << "what is out of sight gets nothing beyond its least";
    for (std::size_t i = 0; i < n.size(); ++i) {
      EXPECT_GE(n[i], objects[i].min);
      EXPECT_LE(n[i], objects[i].max);
    }
  }
}

TEST(SplitBudget, NoExchangeReducesTheError) {
  const std::vector<ObjectView> objects{
      {40'000, 400, 1, 800, 1}, {40'000, 400, 1, 300, 2}, {3000, 30, 1, 500, 1}, {8000, 80, 1, 40, 1}};
  const Counts n = split_budget(objects, 20'000);
  std::vector<double> base(n.begin(), n.end());
  const double best = error_of(objects, base);
  for (std::size_t from = 0; from < n.size(); ++from) {
    for (std::size_t to = 0; to < n.size(); ++to) {
      auto moved = base;
      moved[from] -= 50 / objects[from].vertex_cost;
      moved[to] += 50 / objects[to].vertex_cost;
      if (from == to || moved[from] < objects[from].min || moved[to] > objects[to].max) continue;
      EXPECT_GE(error_of(objects, moved), best * (1 - 1e-6)) << from << " to " << to;
    }
  }
}

TEST(SplitBudget, FollowsTheErrorsOfLevels) {
  // One is smooth to a tenth of its rows and rough below; the other falls evenly.
  const std::vector<LevelError> bent{{100, 0.1}, {1000, 1e-3}, {5000, 1e-4}},
      even{{100, 1e-2}, {1000, 1e-3}, {5000, 2e-4}};
  const auto of_bent = gains_from_errors(bent, 10'000), of_even = gains_from_errors(even, 10'000);
  EXPECT_NEAR(of_bent.front().gain, (0.1 - 1e-3) / 900, 1e-12);
  for (const auto& gains : {of_bent, of_even}) {
    for (std::size_t i = 1; i < gains.size(); ++i) EXPECT_LT(gains[i].gain, gains[i - 1].gain);
  }
  const auto split = [&](double budget) {
    return split_budget(
        std::vector<ObjectView>{{10'000, 100, 1, 500, 1, 0, of_bent}, {10'000, 100, 1, 500, 1, 0, of_even}}, budget);
  };
  EXPECT_GT(split(1000)[0], split(1000)[1]) << "where few rows make it rough it gets more";
  EXPECT_LT(split(12'000)[0], split(12'000)[1]) << "and less where the first thousand were enough";
  // Gains that grow, as measured errors may say, are taken together; a surface without errors has none.
  const std::vector<LevelError> uneven{{100, 0.01}, {200, 0.0099}, {400, 0.001}};
  const auto joined = gains_from_errors(uneven, 800);
  ASSERT_EQ(joined.size(), 2U);
  EXPECT_NEAR(joined[0].gain, 0.009 / 300, 1e-12);
  EXPECT_TRUE(gains_from_errors({}, 800).empty());
  EXPECT_TRUE(gains_from_errors(std::vector<LevelError>{{100, 0.0}}, 800).empty());
}

TEST(SplitBudget, BoundsWinOverTheBudget) {
  const std::vector<ObjectView> objects{{1000, 100, 1, 50, 1}, {1000, 100, 1, 90, 1}};
  EXPECT_EQ(split_budget(objects, 0), (Counts{100, 100}));
  EXPECT_EQ(split_budget(objects, 1e9), (Counts{1000, 1000}));
  EXPECT_TRUE(split_budget({}, 10).empty());
}

/// A machine whose frame costs what `seconds` says of V and the time.
struct Machine {
  std::function<double(double v, double t)> seconds;
  double noise = 0;         ///< Standard deviation of the logarithm.
  double spike_chance = 0;  ///< A frame that takes four times as long.
};

struct Flight {
  double within = 0;     ///< Part of the frames within 1.25 / f0 after the first second.
  double use = 0;        ///< Median part of the frame's time used while below full detail.
  double least_use = 0;  ///< Its 5th percentile.
  double mean_level = 0;
  double wobble = 0;                      ///< Mean |change of V| / V over the last quarter.
  bool was_full = true;                   ///< Every frame of the last quarter at full detail.
  std::vector<double> t, level, seconds;  ///< One for each frame: when it was done, part of all vertices, work.
  std::vector<double> error;              ///< Likewise, see error_of().

  double slowest_percentile(double percent) const {  ///< Covers the work after the first second.
    std::vector<double> sorted;
    for (std::size_t i = 0; i < t.size(); ++i) {
      if (t[i] > 1) sorted.push_back(seconds[i]);
    }
    std::sort(sorted.begin(), sorted.end());
    return sorted[static_cast<std::size_t>(percent / 100 * static_cast<double>(sorted.size() - 1))];
  }
  double level_between(double from, double to) const {
    double sum = 0;
    int count = 0;
    for (std::size_t i = 0; i < t.size(); ++i) {
      if (t[i] >= from && t[i] < to) sum += level[i], ++count;
    }
    return sum / count;
  }
};

Flight fly(const Machine& machine, LodResolver& resolver, double f0, double duration, std::size_t count,
           std::uint32_t vertices) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal(0, 1);
  std::uniform_real_distribution<double> uniform(0, 1);
  std::optional<FrameWork> last;
  std::vector<double> uses, totals;
  int frames = 0, within = 0;
  double t = 0;
  Flight flight;
  while (t < duration) {
    std::vector<ObjectView> objects;
    for (std::size_t i = 0; i < count; ++i) {
      const double distance = 4 + 3 * std::sin(2.0 * t + static_cast<double>(i));
      objects.push_back({vertices, vertices / 100, distance, 900 / distance, 1});
    }
    const Counts n = resolver.resolve(objects, last);
    const double v = cost_of(objects, n), full = static_cast<double>(vertices) * static_cast<double>(count);
    double seconds = machine.seconds(v, t) * std::exp(machine.noise * normal(random));
    if (uniform(random) < machine.spike_chance) seconds *= 4;
    t += std::max(seconds, 1 / f0);  // the display's own rate
    last = FrameWork{static_cast<TimeUs>(t * 1e6), seconds};
    flight.t.push_back(t);
    flight.level.push_back(v / full);
    flight.seconds.push_back(seconds);
    flight.error.push_back(error_of(objects, {n.begin(), n.end()}));
    if (t > 1) {
      ++frames;
      within += seconds <= 1.25 / f0;
      if (v < 0.999 * full) uses.push_back(seconds * f0);
    }
    if (t > 0.75 * duration) {
      totals.push_back(v);
      flight.was_full = flight.was_full && v >= 0.999 * full;
    }
  }
  flight.within = static_cast<double>(within) / frames;
  std::sort(uses.begin(), uses.end());
  flight.use = uses.empty() ? 1 : uses[uses.size() / 2];
  flight.least_use = uses.empty() ? 1 : uses[uses.size() / 20];
  flight.mean_level = flight.level_between(0, duration + 1);
  for (std::size_t i = 1; i < totals.size(); ++i) flight.wobble += std::abs(totals[i] - totals[i - 1]) / totals[i];
  flight.wobble /= static_cast<double>(totals.size());
  return flight;
}

Flight fly(const Machine& machine, double f0, double duration, std::size_t count = 6, std::uint32_t vertices = 8431) {
  BudgetResolver resolver({.f0 = f0});
  return fly(machine, resolver, f0, duration, count, vertices);
}

/// Pictures a second, and the mean error in each half, without a second at the start and after each change of the load.
struct Outcome {
  double rate = 0;
  std::array<double, 2> error{};
};

Outcome outcome_of(const Flight& flight, double duration) {
  Outcome outcome;
  std::array<int, 2> count{};
  double work = 0;
  for (std::size_t i = 0; i < flight.t.size(); ++i) {
    if (flight.t[i] < 4) continue;
    const std::size_t half = flight.t[i] < duration / 2 ? 0 : 1;
    work += flight.seconds[i];
    outcome.error[half] += flight.error[i];
    ++count[half];
  }
  for (std::size_t half = 0; half < 2; ++half) outcome.error[half] /= count[half];
  outcome.rate = (count[0] + count[1]) / work;
  return outcome;
}

TEST(BudgetResolver, ErrorIsNoLargerThanThePapersAtItsRate) {
  constexpr double kSeconds = 40;
  for (const bool busy : {false, true}) {
    const Machine machine{[busy](double v, double) { return (0.008 + 0.06 * v / 50'586) * (busy ? 1.7 : 1); },
                          busy ? 0.15 : 0.03, busy ? 0.03 : 0};
    PaperResolver paper({.near = 0, .far = 9});
    const Outcome theirs = outcome_of(fly(machine, paper, 20, kSeconds, 6, 8431), kSeconds);
    double f0 = theirs.rate;
    Outcome ours = outcome_of(fly(machine, f0, kSeconds), kSeconds);
    for (int i = 0; i < 4; ++i)
      ours = outcome_of(fly(machine, f0 *= 1.002 * theirs.rate / ours.rate, kSeconds), kSeconds);
    EXPECT_NEAR(ours.rate, theirs.rate, 0.02 * theirs.rate) << busy;
    for (std::size_t half = 0; half < 2; ++half) EXPECT_LE(ours.error[half], theirs.error[half]) << busy << half;
  }
}

TEST(DriftingValue, FollowsDriftAndJumpsButNoSpike) {
  std::mt19937 random(3);
  std::normal_distribution<double> noise(0, 0.5);
  DriftingValue value;
  double most_step = 0, error = 0;
  for (int i = 0; i < 400; ++i) {
    const double before = value.value();
    value.add(10 + 0.01 * i + noise(random) + (i % 40 == 33 ? 30 : 0));
    if (i > 5) most_step = std::max(most_step, std::abs(value.value() - before));
    if (i > 20) error += std::abs(value.value() - (10 + 0.01 * i)) / 379;
  }
  EXPECT_LE(most_step, 0.3 * 3 * 1.5 * 0.5) << "one far off is passed over";
  EXPECT_LE(error, 0.2) << "less than half of the noise";
  for (int i = 0; i < 3; ++i) value.add(40 + noise(random));
  EXPECT_NEAR(value.value(), 40, 1);
  for (int i = 0; i < 3; ++i) value.add(2);
  EXPECT_NEAR(value.value(), 2, 1e-9);
}

TEST(PlanMargin, LeavesWhatTheNoiseNeeds) {
  constexpr double kUsed = 0.83;
  const auto fill = [](double deadline, double noise, double used = 0.83) {
    PlanMargin margin(deadline, used);
    std::mt19937 random(3);
    std::normal_distribution<double> normal(0, noise);
    for (int i = 0; i < 200; ++i) margin.add(std::exp(normal(random)));
    return margin.fill();
  };
  EXPECT_NEAR(fill(1, 1e-6), PlanMargin::kEdge, 1e-4);
  EXPECT_NEAR(fill(1, 0.03), PlanMargin::kEdge / std::exp(1.645 * 0.03), 0.02);
  EXPECT_NEAR(fill(1, 0.06), kUsed * std::exp(1.645 * 0.06), 0.03);
  EXPECT_DOUBLE_EQ(fill(1, 0.5), 1) << "beside so much noise being in time gives way to using the time";
  EXPECT_NEAR(fill(1, 0.1), kUsed * std::exp(1.645 * 0.1), 0.04);
  EXPECT_DOUBLE_EQ(fill(1.25, 0.06), 1) << "so much noise fits in a quarter";
  EXPECT_NEAR(fill(1, 0.1, 0.75), 0.75 * std::exp(1.645 * 0.1), 0.04) << "being in time goes before";
  PlanMargin margin(1, kUsed);
  const double before = margin.fill();
  for (std::size_t i = 1; i < PlanMargin::kMinFrames; ++i) margin.add(3);
  EXPECT_EQ(margin.fill(), before) << "of few frames nothing is learnt";
  for (std::size_t i = 0; i < 3 * PlanMargin::kWindow; ++i) margin.add(i % 25 == 7 ? 4.0 : 1.0);
  EXPECT_DOUBLE_EQ(margin.fill(), PlanMargin::kEdge) << "a frame in twenty may be late, however late it is";
}

TEST(BudgetResolver, HoldsTheRateOnASlowMachine) {
  // Full detail (50,586 vertices) would take 200 ms, as the paper's five frames a second.
  const Flight flight = fly({[](double v, double) { return 0.005 + 0.195 * v / 50'586; }, 0.03, 0}, 20, 20);
  EXPECT_GE(flight.within, 0.99);
  EXPECT_GE(flight.use, 0.85);
  EXPECT_GE(flight.mean_level, 0.18) << "all that 45 ms allow is 0.2";
  EXPECT_LE(flight.wobble, 0.01);
}

TEST(BudgetResolver, TimeSavedElsewhereIsUsedAtOnce) {
  BudgetResolver resolver({.f0 = 20});
  ObjectView object{50'586, 500, 1, 500, 1};
  std::optional<FrameWork> last;
  double factor = 1, part = 0;
  const auto frame = [&] {
    object.drawn = resolver.resolve({&object, 1}, last)[0];
    part = object.drawn / 50'586.0;
    last = FrameWork{0, factor * (0.005 + 0.1 * part)};
  };
  for (int i = 0; i < 100; ++i) frame();
  EXPECT_NEAR(part, 0.4, 0.05);
  factor = 0.5;  // of fewer samples
  last->seconds *= factor;
  resolver.scale_costs(factor);
  frame();
  EXPECT_GT(part, 0.8);
  EXPECT_LE(last->seconds, 1.0 / 20);
}

TEST(BudgetResolver, LeavesTimeForNoise) {
  const auto flight_of = [](double noise) {
    return fly({[](double v, double) { return 0.005 + 0.195 * v / 50'586; }, noise, 0}, 20, 30);
  };
  const Flight quiet = flight_of(0.005), usual = flight_of(0.04), loud = flight_of(0.12);
  EXPECT_GE(quiet.use, 0.94);
  EXPECT_GE(usual.use, 0.87);
  EXPECT_GE(loud.use, 0.80);
  EXPECT_GE(usual.least_use, 0.8);
  EXPECT_GE(loud.least_use, 0.75);
  EXPECT_LE(quiet.slowest_percentile(95), 1.0 / 20) << "in the display's own time";
  EXPECT_LE(usual.slowest_percentile(95), 1.03 / 20);
  EXPECT_GE(loud.within, 0.95);
}

TEST(BudgetResolver, DrawsEverythingOnAFastMachine) {
  const Flight flight = fly({[](double v, double) { return 0.001 + 0.006 * v / 50'586; }, 0.05, 0}, 60, 6);
  EXPECT_TRUE(flight.was_full);
  EXPECT_EQ(flight.within, 1);
}

TEST(BudgetResolver, SurvivesNoiseAndSpikes) {
  const Flight flight = fly({[](double v, double) { return 0.004 + 0.1 * v / 50'586; }, 0.10, 0.02}, 60, 20);
  EXPECT_GE(flight.within, 0.95);
  EXPECT_GE(flight.use, 0.80);
}

TEST(BudgetResolver, FollowsAStepOfTheLoadQuickly) {
  // Another program takes two thirds of the machine after five seconds, and leaves after ten.
  const auto seconds = [](double v, double t) { return (0.004 + 0.1 * v / 50'586) * (t > 5 && t < 10 ? 3 : 1); };
  const Flight flight = fly({seconds, 0.03, 0}, 30, 15);
  EXPECT_GE(flight.within, 0.97);
  EXPECT_GE(flight.use, 0.80);
}

TEST(BudgetResolver, FewLateFramesTakeLittleDetail) {
  // Three frames in a row of a steady flight take twice their time, as when another program wakes up.
  const auto seconds = [](double v, double t) { return (0.010 + 0.06 * v / 50'586) * (t > 5 && t < 5.3 ? 2 : 1); };
  const Flight flight = fly({seconds, 0.05, 0}, 20, 12);
  const double before = flight.level_between(3, 5);
  double lowest = before;
  for (std::size_t i = 0; i < flight.t.size(); ++i) {
    if (flight.t[i] > 5) lowest = std::min(lowest, flight.level[i]);
  }
  EXPECT_GE(lowest, 0.15 * before);
  EXPECT_GE(flight.level_between(6.5, 8), 0.9 * before);
}

TEST(BudgetResolver, KeepsTheFloorWhenNothingHelps) {
  const Flight flight = fly({[](double, double) { return 0.2; }, 0.02, 0}, 60, 10);
  EXPECT_GE(flight.mean_level, 0.0099);
}

TEST(BudgetResolver, KeepsDetailWhenFixedCostFillsTheFrame) {
  // Pixels alone take longer than a frame of 60/s; full detail would add 10 ms. A quarter of the fixed cost is 4.5 ms
  // and more.
  for (const double fixed : {0.018, 0.030, 0.200}) {
    const Flight flight = fly({[&](double v, double) { return fixed + 0.010 * v / 50'586; }, 0.02, 0}, 60, 20);
    EXPECT_GE(flight.mean_level, 0.3) << fixed << " s";
    EXPECT_LE(flight.slowest_percentile(99), 1.25 * (fixed + 0.0001) * 1.12)
        << fixed << " s: a quarter more, and the noise of work and plan";
  }
}

TEST(BudgetResolver, HoldsTheRateBesideLargeFixedCost) {
  // With the least of the vertices a frame takes 0.92 to 0.99 of its time: it can be held, so it is.
  for (const double fixed : {0.0145, 0.0150, 0.0155}) {
    const Flight flight = fly({[&](double v, double) { return fixed + 0.1 * v / 50'586; }, 0.01, 0}, 60, 20);
    EXPECT_LE(flight.slowest_percentile(95), 1.03 / 60) << fixed << " s";
    EXPECT_GE(flight.within, 0.99) << fixed << " s";
  }
}

TEST(BudgetResolver, KeepsTheFloorWhenVerticesAreTooMany) {
  // Full detail takes 10 s, the floor of a hundredth of it 0.1 s: late, but every vertex more makes it later.
  const Flight flight = fly({[](double v, double) { return 0.002 + 10 * v / 50'586; }, 0.03, 0}, 20, 30);
  EXPECT_LE(flight.level_between(12, 30), 0.0101);
}

TEST(BudgetResolver, FixedCostTakesDetailOnlyWhilePresent) {
  // A second window covers the screen for five seconds.
  const auto seconds = [](double v, double t) { return (t > 5 && t < 10 ? 0.040 : 0.003) + 0.008 * v / 50'586; };
  const Flight flight = fly({seconds, 0.03, 0}, 60, 16);
  EXPECT_GE(flight.level_between(1, 5), 0.99);
  EXPECT_GE(flight.level_between(7, 10), 0.9) << "8 of the 10 ms that a quarter of 40 ms is";
  EXPECT_GE(flight.level_between(11, 16), 0.99);
}

TEST(BudgetResolver, RecoversAfterLoadOutOfReach) {
  // For five seconds everything takes ten times as long, so that even the floor is late.
  const auto seconds = [](double v, double t) { return (0.004 + 0.1 * v / 50'586) * (t > 5 && t < 10 ? 10 : 1); };
  const Flight flight = fly({seconds, 0.03, 0}, 60, 20);
  int late = 0, frames = 0;
  for (std::size_t i = 0; i < flight.t.size(); ++i) {
    if (flight.t[i] > 5 && flight.t[i] < 10.5) continue;
    ++frames;
    late += flight.t[i] > 1 && flight.seconds[i] > 1.25 / 60;
  }
  EXPECT_LE(late, 0.01 * frames);
  EXPECT_GE(flight.level_between(12, 20), 0.8 * flight.level_between(2, 5));
}

TEST(BudgetResolver, IgnoresInvalidMeasurements) {
  BudgetResolver resolver({.f0 = 60});
  const std::vector<ObjectView> objects{{10'000, 100, 1, 500, 1}};
  const Counts before = resolver.resolve(objects, std::nullopt);
  for (const double bad : {0.0, -1.0, std::nan(""), std::numeric_limits<double>::infinity()}) {
    EXPECT_EQ(resolver.resolve(objects, FrameWork{0, bad}), before);
  }
  EXPECT_TRUE(resolver.resolve({}, FrameWork{0, 0.01}).empty());
}

/// Pictures in a window, as the viewer makes them: work, then a swap that returns at the display's next turn. What is
/// measured is what WorkClock says, or, if `with_wait`, the time from picture to picture.
double level_in_a_window(double full_ms, double display_hz, bool with_wait) {
  const std::vector<ObjectView> objects{{50'000, 500, 1, 500, 1}};
  BudgetResolver resolver({.f0 = display_hz});
  const double turn_us = 1e6 / display_hz;
  WorkClock clock;
  std::optional<FrameWork> last;
  TimeUs now = 0, swapped = 0;
  double level = 0;
  for (int picture = 0; picture < 600; ++picture) {
    clock.start(now);  // levels and rebuilding
    const double part = resolver.resolve(objects, last)[0] / 50'000.0;
    now += static_cast<TimeUs>(400 * full_ms * part);
    clock.stop(now);
    now += 200;  // poses are polled
    clock.start(now);
    now += static_cast<TimeUs>(600 * full_ms * part);
    clock.stop(now);
    const TimeUs worked = clock.take();
    now = static_cast<TimeUs>(std::ceil(static_cast<double>(now) / turn_us) * turn_us);
    last = FrameWork{now, static_cast<double>(with_wait ? now - swapped : worked) / 1e6};
    swapped = now;
    level = part;
  }
  return level;
}

TEST(BudgetResolver, WaitingForTheDisplayTakesNoDetail) {
  for (const double hz : {60.0, 144.0}) {
    // All vertices take three quarters of the display's turn.
    EXPECT_EQ(level_in_a_window(750 / hz, hz, false), 1) << hz;
    EXPECT_LT(level_in_a_window(750 / hz, hz, true), 0.9) << "else this test could not fail";
  }
  // And where they take twice that, so many are drawn as the turn allows.
  EXPECT_NEAR(level_in_a_window(2000 / 60.0, 60, false), 0.46, 0.04);
}

TEST(WorkClock, CountsWhatLiesBetweenStartAndStop) {
  WorkClock clock;
  clock.stop(50);
  EXPECT_EQ(clock.take(), 0);
  clock.start(100);
  clock.stop(130);
  clock.start(200);
  clock.stop(207);
  EXPECT_EQ(clock.take(), 37);
  EXPECT_EQ(clock.take(), 0);
}

}  // namespace
}  // namespace eigencast
