// SPDX-License-Identifier: MIT
#include "sender/source.h"

#include <gtest/gtest.h>

#include "common/surface/shapes.h"

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
