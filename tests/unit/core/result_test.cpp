// SPDX-License-Identifier: MIT
#include "common/core/result.h"

#include <gtest/gtest.h>

#include <set>

namespace eigencast {
namespace {

Result<int> half(int v) {
  if (v % 2) return fail(ErrorCode::kInvalidArgument, "odd");
  return v / 2;
}

TEST(Result, HoldsAValueOrAnError) {
  EXPECT_EQ(*half(4), 2);
  ASSERT_FALSE(half(3));
  EXPECT_EQ(half(3).error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(in_context("file.obj", half(3).error()).message, "file.obj: odd");
}

TEST(Result, VoidResultIsGoodUnlessItFailed) {
  EXPECT_TRUE(Result<void>());
  EXPECT_FALSE(Result<void>(fail(ErrorCode::kIo, "disk full")));
}

TEST(Result, EveryCodeHasItsOwnName) {
  std::set<std::string_view> names;
  for (int c = 0; c <= static_cast<int>(ErrorCode::kInternal); ++c) names.insert(name_of(static_cast<ErrorCode>(c)));
  EXPECT_EQ(names.size(), static_cast<std::size_t>(ErrorCode::kInternal) + 1);
  EXPECT_FALSE(names.contains("unknown"));
}

}  // namespace
}  // namespace eigencast
