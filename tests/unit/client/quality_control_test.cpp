// SPDX-License-Identifier: MIT
#include "common/levels/quality_control.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <random>
#include <utility>

namespace eigencast {
namespace {

constexpr double kF0 = 20;

/// A machine on which a picture takes (fixed + vertices V) times what the knobs leave, with noise.
struct KnobMachine {
  double fixed = 0.05, vertices = 0.05;  ///< Seconds; `vertices`: of all of them.
  std::vector<double> saved{0.5, 0.4, 0.4};
  std::vector<double> error{0.4, 0.15, 3};
  double noise = 0.03;
  double spikes = 0;          ///< The part of the pictures that another program makes three times as long.
  bool has_geometry = false;  ///< Vertices keep more of their time than pixels do: its root.
  double least_f0 = 0, deadline = 1;
  std::function<double(int)> load = [](int) { return 1.0; };  ///< By the number of the picture.
};

/// What the controller believes before it measures, wrong on purpose.
QualityControl::Settings guesses_for(const KnobMachine& machine, bool trials) {
  QualityControl::Settings settings;
  settings.budget.f0 = kF0;
  settings.vertex_error = 0.16;
  settings.trials = trials;
  settings.least_f0 = machine.least_f0;
  settings.budget.deadline = machine.deadline;
  const std::vector<QualityKnob::Step> two{{0, 0}, {1, 1}};
  settings.knobs = {resolution_knob(0.4, 0.3), {0.2, 0.3, two}, {2.5, 0.3, two}};
  settings.knobs.resize(machine.saved.size());
  return settings;
}

struct PlayedPictures {
  std::vector<double> seconds, levels, errors, rates;
  std::vector<std::vector<std::size_t>> steps;
  int changes(std::size_t from, std::size_t to) const {
    int count = 0;
    for (std::size_t i = from + 1; i < to; ++i) count += steps[i] != steps[i - 1] ? 1 : 0;
    return count;
  }
  double late(std::size_t from, std::size_t to) const {
    return std::count_if(seconds.begin() + static_cast<long>(from), seconds.begin() + static_cast<long>(to),
                         [](double s) { return s > 1.1 / kF0; }) /
           static_cast<double>(to - from);
  }
};

double left_by_knobs(const KnobMachine& machine, const std::vector<QualityKnob>& knobs,
                     const std::vector<std::size_t>& steps) {
  double left = 1;
  for (std::size_t k = 0; k < steps.size(); ++k) left *= 1 - machine.saved[k] * knobs[k].steps[steps[k]].saved;
  return left;
}

double error_by_knobs(const KnobMachine& machine, const std::vector<QualityKnob>& knobs,
                      const std::vector<std::size_t>& steps, double level) {
  double error = 0.4 * machine.error[0] * (1 / level - 1);
  for (std::size_t k = 0; k < steps.size(); ++k) error += machine.error[k] * knobs[k].steps[steps[k]].error;
  return error;
}

PlayedPictures played_on(const KnobMachine& machine, int pictures, bool trials = true) {
  QualityControl control(guesses_for(machine, trials));
  std::mt19937 random(7);
  std::normal_distribution<double> normal;
  constexpr std::uint32_t kVertices = 50'000;
  ObjectView object{kVertices, 1000, 1, 500, 1};
  PlayedPictures result;
  std::optional<FrameWork> last;
  TimeUs now = 0;
  for (int i = 0; i < pictures; ++i) {
    const auto choice = control.choose({&object, 1}, last);
    object.drawn = choice.levels[0];
    const double level = choice.levels[0] / double{kVertices};
    const double left = left_by_knobs(machine, control.knobs(), choice.steps);
    const double seconds =
        machine.load(i) *
        (left * machine.fixed + (machine.has_geometry ? std::sqrt(left) : left) * machine.vertices * level) *
        std::exp(machine.noise * normal(random)) *
        (std::uniform_real_distribution(0.0, 1.0)(random) < machine.spikes ? 3 : 1);
    if (const auto knob = control.trial()) {
      const std::size_t step = choice.steps[*knob];
      const QualityKnob::Step part = step == 0 ? QualityKnob::Step{1, 1} : control.knobs()[*knob].steps[step];
      const double cheaper = 1 - machine.saved[*knob] * part.saved;
      control.measured(*knob, step == 0 ? 1 : cheaper, step == 0 ? cheaper : 1, machine.error[*knob] * part.error);
    }
    now += static_cast<TimeUs>(1e6 * seconds);
    last = FrameWork{now, seconds};
    result.seconds.push_back(seconds);
    result.levels.push_back(level);
    result.rates.push_back(control.f0());
    result.steps.push_back(choice.steps);
    result.errors.push_back(error_by_knobs(machine, control.knobs(), choice.steps, level));
  }
  return result;
}

/// The least error of all combinations and levels that are in time on average, planning for `part` of the time.
double least_error(const KnobMachine& machine, double part) {
  const auto knobs = guesses_for(machine, true).knobs;
  double least = 1e9;
  for (std::size_t a = 0; a < knobs[0].steps.size(); ++a) {
    for (const std::size_t b : {0U, 1U}) {
      for (const std::size_t c : {0U, 1U}) {
        const double room = part / kF0 / left_by_knobs(machine, knobs, {a, b, c}) - machine.fixed;
        const double level = std::min(1.0, room / machine.vertices);
        if (level > 0.02) least = std::min(least, error_by_knobs(machine, knobs, {a, b, c}, level));
      }
    }
  }
  return least;
}

TEST(QualityControl, AFastMachineGivesUpNothing) {
  const PlayedPictures fast = played_on({.fixed = 0.015, .vertices = 0.02}, 600);
  EXPECT_EQ(fast.changes(0, 600), 0);
  EXPECT_EQ(fast.steps.back(), (std::vector<std::size_t>{0, 0, 0}));
  EXPECT_EQ(fast.levels.back(), 1);
}

TEST(QualityControl, GivesUpWhatIsLeastSeen) {
  // Of what is in time the least error, up to the room that noise needs, on machines of different costs.
  for (const KnobMachine& machine :
       {KnobMachine{}, KnobMachine{.fixed = 0.07, .vertices = 0.03}, KnobMachine{.fixed = 0.02, .vertices = 0.2},
        KnobMachine{.saved = {0.6, 0.05, 0.3}}, KnobMachine{.error = {0.4, 0.9, 0.2}}}) {
    const PlayedPictures found = played_on(machine, 900);
    double error = 0;
    for (std::size_t i = 600; i < 900; ++i) error += found.errors[i] / 300;
    EXPECT_LE(error, 1.3 * least_error(machine, 0.85)) << machine.fixed << " " << machine.saved[1];
    EXPECT_LE(found.late(100, 900), 0.06);
    EXPECT_LE(found.changes(300, 900), 2) << "it has settled";
  }
}

TEST(QualityControl, LearnsByChangingWhereNothingIsMeasuredBeside) {
  const KnobMachine machine{.fixed = 0.06, .vertices = 0.06, .saved = {0.55, 0.5, 0.2}};
  const PlayedPictures found = played_on(machine, 900, false);
  EXPECT_LE(found.late(150, 900), 0.06);
  EXPECT_LE(found.changes(400, 900), 2);
  EXPECT_GT(found.levels.back(), 0.3);
}

TEST(QualityControl, WhatSavesNothingStays) {
  // Samples cost nothing, as on most graphics cards; the shadow is dear.
  const PlayedPictures found = played_on({.fixed = 0.05, .vertices = 0.05, .saved = {0.5, 0, 0.4}}, 600);
  for (std::size_t i = 300; i < 600; ++i) ASSERT_EQ(found.steps[i][1], 0U);
}

TEST(QualityControl, RecoversAfterALoad) {
  const KnobMachine machine{
      .fixed = 0.02, .vertices = 0.015, .load = [](int i) { return i > 200 && i < 500 ? 4.0 : 1.0; }};
  const PlayedPictures found = played_on(machine, 1500);
  EXPECT_NE(found.steps[450], (std::vector<std::size_t>{0, 0, 0}));
  EXPECT_LE(found.late(260, 490), 0.1);
  EXPECT_EQ(found.steps.back(), (std::vector<std::size_t>{0, 0, 0}));
  EXPECT_EQ(found.levels.back(), 1);
}

// What vertices cost there is a guess until their number changes: far too high, or far too low.
TEST(QualityControl, ASuddenLoadOnAFastMachineIsAnsweredInTime) {
  for (const double vertices : {0.03, 0.1, 0.4, 0.8, 0.95}) {
    for (const double load : {4.0, 8.0}) {
      const double whole = 0.35 / kF0;
      const KnobMachine machine{.fixed = (1 - vertices) * whole, .vertices = vertices * whole, .load = [load](int i) {
                                  return i < 200 ? 1 : load;
                                }};
      const PlayedPictures found = played_on(machine, 700);
      EXPECT_LE(found.late(200, 230) * 30, 12) << vertices << " x " << load;
      EXPECT_LE(found.late(230, 700), 0.02) << vertices << " x " << load;
      double at_first = 0, at_last = 0;
      for (std::size_t i = 0; i < 60; ++i) at_first += found.errors[240 + i], at_last += found.errors[640 + i];
      EXPECT_LE(at_first, 1.15 * at_last) << vertices << " x " << load;
    }
  }
}

TEST(QualityControl, NeverOscillates) {
  // A load that swings just where the choice turns over, more slowly than it is learned, or faster.
  for (const int period : {40, 200, 700}) {
    const KnobMachine machine{.load = [period](int i) { return 1 + 0.2 * std::sin(6.2831853 * i / period); }};
    EXPECT_LE(played_on(machine, 6000).changes(200, 6000), 60) << period;
    EXPECT_LE(played_on(machine, 12'000).changes(6000, 12'000), 40) << period << ": and ever less";
  }
}

/// Parts of a run, in pictures.
struct Span {
  std::size_t from, to;
};
double percentile(const std::vector<double>& values, const Span& span, double part) {
  std::vector<double> sorted(values.begin() + static_cast<long>(span.from),
                             values.begin() + static_cast<long>(span.to));
  std::sort(sorted.begin(), sorted.end());
  return sorted[static_cast<std::size_t>(part * static_cast<double>(sorted.size() - 1))];
}

TEST(QualityControl, LevelsAreSteadyBesideNoiseSpikesAndAStepOfTheLoad) {
  // As six horses on a processor that draws and has other things to do.
  for (const double noise : {0.03, 0.08, 0.12}) {
    KnobMachine machine{.fixed = 0.09, .vertices = 0.052, .saved = {0.6, 0.5, 0.4}, .noise = noise, .spikes = 0.02};
    machine.has_geometry = true;
    machine.load = [](int i) { return i >= 600 && i < 1200 ? 1.4 : 1.0; };
    const PlayedPictures found = played_on(machine, 1800);
    EXPECT_GE(*std::min_element(found.levels.begin(), found.levels.end()), QualityControl::kFewVertices - 1e-4);
    constexpr std::size_t kSettled = 60;  // pictures after the start and after each step
    for (const Span& steady : {Span{kSettled, 600}, Span{600 + kSettled, 1200}, Span{1200 + kSettled, 1800}}) {
      const double least = percentile(found.levels, steady, 0.05), most = percentile(found.levels, steady, 0.95);
      EXPECT_LE(most / least, noise < 0.05 ? 1.25 : 1.4) << noise << " from picture " << steady.from;
      EXPECT_LE(found.changes(steady.from, steady.to), 1) << noise << " from picture " << steady.from;
      EXPECT_GE(percentile(found.seconds, steady, 0.05) * kF0, noise < 0.1 ? 0.8 : 0.78) << noise;
      EXPECT_LE(percentile(found.seconds, steady, 0.5) * kF0, 1) << noise;
      EXPECT_LE(found.late(steady.from, steady.to), noise < 0.05 ? 0.03 : noise < 0.1 ? 0.08 : 0.22) << noise;
    }
  }
}

TEST(QualityControl, FewWholePicturesRatherThanManyPoorOnes) {
  // A whole picture takes 110 ms, and 35 ms once another program has gone.
  const KnobMachine machine{.least_f0 = 10, .load = [](int i) { return i < 600 ? 1.1 : 0.35; }};
  const PlayedPictures found = played_on(machine, 1200);
  for (std::size_t i = 30; i < 600; ++i) ASSERT_EQ(found.rates[i], 10) << i;
  EXPECT_LT(percentile(found.errors, {100, 600}, 0.95),
            0.3 * percentile(played_on({.load = machine.load}, 600).errors, {100, 600}, 0.5));
  EXPECT_EQ(found.rates.back(), kF0);
  EXPECT_EQ(found.steps.back(), (std::vector<std::size_t>{0, 0, 0}));
  EXPECT_EQ(played_on({.fixed = 0.04, .vertices = 0.03, .least_f0 = 10}, 600).rates.back(), kF0)
      << "70 ms can be lowered to 50";
}

TEST(QualityControl, FewVerticesAreNoSavingWhereTheyCostNothing) {
  // The picture alone takes twice its time, and vertices nearly nothing.
  const KnobMachine machine{.fixed = 0.4, .vertices = 0.01};
  const PlayedPictures found = played_on(machine, 400);
  EXPECT_GE(*std::min_element(found.levels.begin(), found.levels.end()), QualityControl::kFewVertices - 1e-4);
}

TEST(QualityControl, NoSurfaceGoesUnderAFifthForNothing) {
  // One is far away. Without four fifths of the vertices pictures take 0.5 %, or two thirds, less.
  for (const auto& [fixed, vertices] : {std::pair(0.4, 0.002), std::pair(0.03, 0.2)}) {
    QualityControl control(guesses_for({}, false));
    std::vector<ObjectView> objects{{50'000, 1000, 1, 500, 1}, {50'000, 1000, 9, 20, 1}};
    std::optional<FrameWork> last;
    QualityControl::Choice choice;
    for (int i = 0; i < 200; ++i) {
      choice = control.choose(objects, last);
      for (std::size_t k = 0; k < 2; ++k) objects[k].drawn = choice.levels[k];
      const double drawn = (choice.levels[0] + choice.levels[1]) / 100'000.0;
      last = FrameWork{400'000 * i, fixed + vertices * drawn};
    }
    const auto least = *std::min_element(choice.levels.begin(), choice.levels.end());
    EXPECT_EQ(least >= 10'000, vertices < 0.1) << least;
  }
}

TEST(QualityControl, ABusyStartKeepsAFifthOfTheVertices) {
  // The first pictures take 2 to 10 times as long, for less and less or in one step, as they do while programs start.
  for (const double vertices : {0.0, 0.05, 0.1}) {
    for (const double whole : {1.5, 3.0, 6.0}) {
      for (const double load : {2.0, 4.0, 10.0}) {
        for (const bool fades : {false, true}) {
          KnobMachine machine{.fixed = (1 - vertices) * whole / kF0, .vertices = vertices * whole / kF0, .noise = 0.06};
          machine.load = [&](int i) { return fades ? 1 + (load - 1) * std::exp(-i / 15.0) : i < 30 ? load : 1; };
          const PlayedPictures found = played_on(machine, 300);
          EXPECT_GE(*std::min_element(found.levels.begin(), found.levels.end()), QualityControl::kFewVertices - 1e-4)
              << vertices << " of " << whole << " x " << load << " fades " << fades;
        }
      }
    }
  }
}

TEST(VertexProbe, WhatGrowsBesideIsNotOfTheVertices) {
  for (const double vertex_s : {0.0, 1e-6}) {
    VertexProbe probe;
    probe.start();
    std::optional<VertexProbe::Found> found;
    for (int i = 0; !found; ++i) {
      const double vertices = probe.doubles() ? 20'000 : 10'000;
      found = probe.add(vertices, 0.1 + 0.002 * i + vertex_s * vertices + (i % 2 == 0 ? 1e-4 : -1e-4));
    }
    EXPECT_NEAR(found->vertex_s, vertex_s, 3e-8);
    EXPECT_NEAR(found->few_s, 0.1 + 0.002 * 11.5 + vertex_s * 10'000, 1e-3);
  }
}

TEST(QualityControl, UsesTheTimeWhileSomethingIsLowered) {
  const PlayedPictures found = played_on({.fixed = 0.03, .vertices = 0.08}, 900);
  std::vector<double> used;
  for (std::size_t i = 100; i < 900; ++i) {
    if (found.levels[i] < 0.999) used.push_back(found.seconds[i] * kF0);
  }
  ASSERT_GT(used.size(), 200U);
  std::sort(used.begin(), used.end());
  EXPECT_GE(used[used.size() / 20], 0.8);
}

TEST(QualityControl, UsesTheTimeOfAGait) {
  // Whole pictures that take up to three and a half times their time, more and less as animals stride.
  double worst = 1, sum = 0;
  int machines = 0;
  for (double whole = 1.05; whole < 3.5; whole *= 1.04, ++machines) {
    KnobMachine machine{.fixed = 0.7 * whole / kF0, .vertices = 0.3 * whole / kF0, .noise = 0.04, .deadline = 1.25};
    machine.load = [](int i) { return 1 + 0.07 * std::sin(6.2831853 * i / 28); };
    const PlayedPictures found = played_on(machine, 900);
    const double used = kF0 * percentile(found.seconds, {60, 900}, 0.05);
    worst = std::min(worst, used), sum += used;
    EXPECT_LE(found.changes(200, 900), 5) << whole;
  }
  EXPECT_GE(worst, 0.77);
  EXPECT_GE(sum / machines, 0.84);
}

}  // namespace
}  // namespace eigencast
