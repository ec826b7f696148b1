// SPDX-License-Identifier: MIT
#include "common/core/memory_budget.h"

#include <gtest/gtest.h>

#include <limits>

namespace eigencast {
namespace {

TEST(MemoryBudget, SharesComeBackAndNoMoreIsGiven) {
  MemoryBudget budget(100);
  auto first = budget.take(60, "first");
  ASSERT_TRUE(first);
  const auto second = budget.take(41, "second");
  ASSERT_FALSE(second);
  EXPECT_EQ(second.error().code, ErrorCode::kTooLarge);
  MemoryBudget::Share copy = *first;
  *first = nullptr;
  EXPECT_EQ(budget.remaining(), 40u);
  copy = nullptr;
  EXPECT_EQ(budget.remaining(), 100u);
  EXPECT_TRUE(budget.take(100, "all"));
  EXPECT_FALSE(budget.take(std::numeric_limits<std::uint64_t>::max(), "more than there is"));
}

TEST(MemoryBudget, LowerLimitLeavesWhatIsTaken) {
  MemoryBudget budget(100);
  const auto share = budget.take(60, "share");
  ASSERT_TRUE(share);
  budget.set_limit(50);
  EXPECT_EQ(budget.remaining(), 0u);
  EXPECT_FALSE(budget.take(1, "more"));
  budget.set_limit(70);
  EXPECT_EQ(budget.remaining(), 10u);
}

TEST(MemoryBudget, ProcessHasAShareOfTheMachine) {
  EXPECT_GT(received_memory().remaining(), 1'000'000u);
}

}  // namespace
}  // namespace eigencast
