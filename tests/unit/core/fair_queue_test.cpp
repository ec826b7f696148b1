// SPDX-License-Identifier: MIT
#include "common/core/fair_queue.h"

#include <gtest/gtest.h>

#include <map>
#include <string>

namespace eigencast {
namespace {

TEST(FairQueue, TurnsAreFairByCostAndKeepTheOrderOfEach) {
  FairQueue<std::string> queue;
  for (int i = 0; i < 300; ++i) {
    for (const std::string holder : {"a", "b", "large"}) {
      EXPECT_TRUE(queue.push(holder, holder == "large" ? 10 : 1, holder + std::to_string(i)));
    }
  }
  std::map<char, int> cost, next;
  for (int i = 0; i < 210; ++i) {
    const auto [took, item] = queue.pop();
    cost[item[0]] += static_cast<int>(took);
    EXPECT_EQ(item.substr(item.find_first_of("0123456789")), std::to_string(next[item[0]]++));
  }
  EXPECT_EQ(cost['a'], 100);
  EXPECT_EQ(cost['b'], 100);
  EXPECT_EQ(cost['l'], 100);
  queue.push("newcomer", 1, "newcomer");
  int before = 0;
  while (queue.pop().item != "newcomer") ++before;
  EXPECT_LE(before, 3) << "one of each";
  while (!queue.empty()) queue.pop();
}

TEST(FairQueue, OneHolderLeavesRoomToOthers) {
  FairQueue<int> queue;
  const auto fill = [&](const std::string& holder) {
    int count = 0;
    while (queue.push(holder, 10, 0, 1'000)) ++count;
    return count;
  };
  EXPECT_EQ(fill("a"), 20) << "a fifth";
  EXPECT_EQ(fill("b"), 16);
  EXPECT_GT(fill("c"), 10);
  EXPECT_GT(fill(""), 40) << "the broker's own";
  queue.pop();
  while (!queue.empty()) queue.pop();
  EXPECT_EQ(fill("a"), 20);
}

}  // namespace
}  // namespace eigencast
