// SPDX-License-Identifier: MIT
#include "sender/source.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

namespace eigencast {
namespace {

/// A surface whose error falls as a power of the rank.
Result<TriedRank> power_law(int rank, int most = 4096) {
  const int r = std::min(rank, most);
  return TriedRank{r, 0.3 * std::pow(r, -1.1)};
}

TEST(RankSearch, FindsANearlySmallestRank) {
  for (const double target : {5e-3, 2e-3, 1e-3, 7e-4, 4e-4}) {
    const double needed = std::pow(target / 0.3, -1 / 1.1);
    int bakes = 0;
    const auto choice = choose_rank(target, 512, [&](int rank) {
      ++bakes;
      return power_law(rank);
    });
    ASSERT_TRUE(choice) << choice.error().message;
    EXPECT_LE(choice->chosen.error, target);
    EXPECT_GE(choice->chosen.rank, needed);
    EXPECT_LE(choice->chosen.rank, 1.1 * needed + 2);
    EXPECT_LE(bakes, 10);
    EXPECT_TRUE(std::is_sorted(choice->tried.begin(), choice->tried.end(),
                               [](const TriedRank& a, const TriedRank& b) { return a.rank < b.rank; }));
  }
}

TEST(RankSearch, FindsASuddenDropOfTheError) {
  const auto choice = choose_rank(1e-3, 512, [](int rank) { return TriedRank{rank, rank < 130 ? 1e-2 : 0}; });
  ASSERT_TRUE(choice) << choice.error().message;
  EXPECT_GE(choice->chosen.rank, 130);
  EXPECT_LE(choice->chosen.rank, 200);
}

TEST(RankSearch, FirstRankMeetsLaxTarget) {
  const auto choice = choose_rank(0.1, 512, [](int rank) { return power_law(rank); });
  ASSERT_TRUE(choice);
  EXPECT_EQ(choice->tried.size(), 1u);
  EXPECT_EQ(choice->chosen.rank, 25);
}

TEST(RankSearch, UnreachableTargetIsRefused) {
  const auto choice = choose_rank(1e-6, 512, [](int rank) { return power_law(rank); });
  ASSERT_FALSE(choice);
  EXPECT_EQ(choice.error().code, ErrorCode::kInvalidArgument);
  const auto small = choose_rank(1e-6, 512, [](int rank) { return power_law(rank, 70); });
  ASSERT_FALSE(small);
  EXPECT_EQ(small.error().code, ErrorCode::kInvalidArgument);
}

TEST(RankSearch, AFailureEndsTheSearch) {
  int bakes = 0;
  const auto choice = choose_rank(1e-6, 512, [&](int) -> Result<TriedRank> {
    ++bakes;
    return fail(ErrorCode::kCancelled, "stopped");
  });
  ASSERT_FALSE(choice);
  EXPECT_EQ(choice.error().code, ErrorCode::kCancelled);
  EXPECT_EQ(bakes, 1);
}

}  // namespace
}  // namespace eigencast
