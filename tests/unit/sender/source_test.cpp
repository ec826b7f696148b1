// SPDX-License-Identifier: MIT
#include "sender/source.h"

#include <gtest/gtest.h>

#include <fstream>

#include "common/surface/shapes.h"
#include "tests/support/process.h"

namespace eigencast {
namespace {

TEST(Source, EveryBuiltInShapeOpensByItsName) {
  for (const std::string& name : builtin_names()) {
    SourceOptions options;
    options.input = name;
    const auto clip = open_source(options);
    ASSERT_TRUE(clip) << name << ": " << clip.error().message;
    EXPECT_GT((*clip)->frame_count(), 1u) << name;
  }
}

TEST(Source, TheAssetIsNamedWithoutThePathToItsFile) {
  const testing::TemporaryFolder folder;
  std::ofstream(folder.file("tetra.off")) << "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n";
  SourceOptions options;
  options.input = folder.file("tetra.off");
  options.rank = 4;
  const auto source = bake_source(options, {});
  ASSERT_TRUE(source) << source.error().message;
  EXPECT_EQ(source->baked.asset.name, "tetra");
}

TEST(Source, AnUnknownNameIsRefusedWithTheNamesThereAre) {
  SourceOptions options;
  options.input = "hearth";
  const auto clip = open_source(options);
  ASSERT_FALSE(clip);
  EXPECT_EQ(clip.error().code, ErrorCode::kNotFound);
  EXPECT_NE(clip.error().message.find("heart"), std::string::npos);
  EXPECT_NE(clip.error().message.find("torus"), std::string::npos);
}

}  // namespace
}  // namespace eigencast
