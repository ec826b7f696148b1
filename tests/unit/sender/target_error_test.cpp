// SPDX-License-Identifier: MIT
#include "sender/source.h"

#include <gtest/gtest.h>

#include "common/surface/formats/write.h"
#include "tests/support/process.h"

namespace eigencast {
namespace {

TEST(TargetError, ChosenRankMeetsTheTarget) {
  const testing::TemporaryFolder folder;
  SourceOptions options;
  options.input = "torus";
  options.cache_dir = folder.file("cache");
  options.target_error = 1.5e-2;
  const auto source = bake_for_target(options, {});
  ASSERT_TRUE(source) << source.error().message;
  ASSERT_TRUE(source->rank_choice);
  const TriedRank& chosen = source->rank_choice->chosen;
  EXPECT_EQ(static_cast<int>(source->baked.asset.rank), chosen.rank);
  EXPECT_LE(chosen.error, 1.5e-2);
  EXPECT_EQ(*error_on_samples(source->baked.asset, *source->clip), chosen.error);
}

TEST(TargetError, MeshIsJudgedByGivenPoses) {
  const testing::TemporaryFolder folder;
  SourceOptions options;
  options.input = "torus";
  const auto clip = open_source(options);
  ASSERT_TRUE(write_surface((*clip)->rest(), folder.file("rest.obj")));
  options.input = folder.file("rest.obj");
  options.cache_dir = folder.file("cache");
  options.target_error = 5e-2;
  const auto alone = bake_for_target(options, {});
  ASSERT_FALSE(alone);
  EXPECT_EQ(alone.error().code, ErrorCode::kInvalidArgument);
  options.poses = "torus";
  const auto source = bake_for_target(options, {});
  ASSERT_TRUE(source) << source.error().message;
  EXPECT_LE(source->rank_choice->chosen.error, 5e-2);
  options.poses = "bar";
  const auto other = bake_for_target(options, {});
  ASSERT_FALSE(other);
  EXPECT_EQ(other.error().code, ErrorCode::kInvalidArgument);
}

}  // namespace
}  // namespace eigencast
