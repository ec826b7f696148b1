// SPDX-License-Identifier: MIT
#include "sdk/rank_trial.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

namespace eigencast {
namespace {

/// Points such as trials give, in any order: errors of basis and coding add up as squares.
std::vector<TrialPoint> points_like(std::uint32_t seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> near(0.9, 1.1);
  std::vector<TrialPoint> points;
  for (const int rank : {25, 100, 200, 300}) {
    for (const int products : {10, 20}) {
      const double basis = 0.2 / rank * near(random);
      for (double coding = 8e-3; coding > 1e-4; coding /= 2) {
        const double kbit = 0.05 * rank * (1 - std::log2(coding) / 4) * near(random);
        points.push_back({rank, products, coding, std::hypot(basis, coding), kbit});
      }
    }
  }
  std::shuffle(points.begin(), points.end(), random);
  return points;
}

double cost(const TrialPoint& point) {
  return priced(point.kbit_per_s, point.rank);
}

TEST(RankChoice, NoPointBeatsTheChoice) {
  for (std::uint32_t seed = 0; seed < 50; ++seed) {
    const auto points = points_like(seed);
    for (const double target : {1e-2, 3e-3, 1.2e-3, 7e-4}) {
      const TrialPoint chosen = choose(points, {1, target, 0}).chosen;
      for (const TrialPoint& p : points) {
        EXPECT_FALSE(cost(p) < cost(chosen) && p.error <= chosen.error);
        EXPECT_FALSE(cost(p) <= cost(chosen) && p.error < chosen.error);
      }
      const auto front = front_of(points);
      EXPECT_TRUE(std::any_of(front.begin(), front.end(), [&](const TrialPoint& p) { return p == chosen; }));
    }
  }
}

TEST(RankChoice, WishIsMetOrStatesByHowMuchNot) {
  for (std::uint32_t seed = 0; seed < 50; ++seed) {
    const auto points = points_like(seed);
    const auto least = std::min_element(points.begin(), points.end(),
                                        [](const TrialPoint& a, const TrialPoint& b) { return a.error < b.error; });
    for (const double target : {1e-2, 1.2e-3, 7e-4, 1e-5}) {
      const RankTrial choice = choose(points, {1, target, 0});
      EXPECT_EQ(choice.asked, target);
      EXPECT_EQ(choice.is_met(), least->error <= target);
      EXPECT_TRUE(choice.is_met() || choice.chosen.error == least->error);
    }
    for (const double kbit : {1.0, 8.0, 30.0, 500.0}) {
      const RankTrial choice = choose(points, {1, 0, kbit});
      EXPECT_TRUE(choice.is_rate);
      EXPECT_EQ(choice.asked, kbit);
      for (const TrialPoint& p : points) EXPECT_TRUE(choice.is_met() || p.kbit_per_s >= choice.chosen.kbit_per_s);
    }
  }
}

TEST(RankChoice, BetterWishesCostMore) {
  for (std::uint32_t seed = 0; seed < 50; ++seed) {
    auto points = points_like(seed);
    points.insert(points.begin(), {200, 10, 1e-3, 2e-3, 40});
    double before = 0, error = HUGE_VAL;
    for (const double quality : {0.3, 0.5, 1.0, 1.5, 2.0, 3.0}) {
      const RankTrial choice = choose(points, {quality, 0, 0});
      EXPECT_DOUBLE_EQ(choice.asked, 2e-3 / quality);
      if (!choice.is_met()) break;
      EXPECT_GE(cost(choice.chosen), before);
      before = cost(choice.chosen);
    }
    for (const double kbit : {5.0, 10.0, 20.0, 40.0}) {
      const RankTrial choice = choose(points, {1, 0, kbit});
      if (!choice.is_met()) continue;
      EXPECT_LE(priced(choice.chosen.error, choice.chosen.rank), error);
      error = priced(choice.chosen.error, choice.chosen.rank);
    }
  }
}

TEST(RankChoice, FrontFallsInErrorAsBitsRise) {
  for (std::uint32_t seed = 0; seed < 50; ++seed) {
    const auto points = points_like(seed);
    const auto front = front_of(points);
    ASSERT_FALSE(front.empty());
    for (std::size_t i = 1; i < front.size(); ++i) {
      EXPECT_GT(cost(front[i]), cost(front[i - 1]));
      EXPECT_LT(front[i].error, front[i - 1].error);
    }
    for (const TrialPoint& p : points) {
      EXPECT_TRUE(std::any_of(front.begin(), front.end(),
                              [&](const TrialPoint& f) { return cost(f) <= cost(p) && f.error <= p.error; }));
    }
  }
}

TEST(RankChoice, ColumnsHaveToPay) {
  const std::vector<TrialPoint> points{{200, 10, 1e-3, 2e-3, 30}, {300, 10, 1e-3, 2e-3, 29}, {300, 20, 1e-3, 2e-3, 28}};
  EXPECT_EQ(choose(points, {1, 2e-3, 0}).chosen.products, 20);
  EXPECT_EQ(choose({points[0], points[1]}, {1, 2e-3, 0}).chosen.rank, 200);
}

TEST(RankChoice, StillSurfacesMeetAnyWish) {
  const std::vector<TrialPoint> still{{100, 10, 1e-3, 0, 2.5}, {25, 1, 8e-3, 0, 2.5}};
  const RankTrial choice = choose(still, {});
  EXPECT_EQ(choice.chosen.rank, 25);
  EXPECT_TRUE(choice.is_met());
}

}  // namespace
}  // namespace eigencast
