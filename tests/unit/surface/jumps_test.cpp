// SPDX-License-Identifier: MIT
#include "common/surface/jumps.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "common/surface/read.h"
#include "common/surface/shapes.h"

namespace eigencast {
namespace {

using testing::HasSubstr;

/// The findings in a built-in clip of 24 frames after `change` has had each pose.
template <typename Change>
std::vector<std::string> findings_of(const Change& change) {
  const auto clip = builtin_clip("torus");
  JumpFinder jumps((*clip)->rest());
  for (std::size_t t = 0; t < 24; ++t) {
    auto pose = *(*clip)->pose(t);
    change(t, pose);
    jumps.add(pose);
  }
  return jumps.findings();
}

TEST(Jumps, a_frame_out_of_place_is_named_once) {
  const auto findings = findings_of([](std::size_t t, std::vector<Vec3>& pose) {
    for (Vec3& p : pose) p[0] += t == 7 ? 2.0 : 0.0;
  });
  ASSERT_EQ(findings.size(), 1u);
  EXPECT_THAT(findings[0], HasSubstr("frame 7: the surface jumps"));
}

TEST(Jumps, two_vertices_that_change_places_are_named) {
  const auto findings = findings_of([](std::size_t t, std::vector<Vec3>& pose) {
    if (t >= 9) std::swap(pose[0], pose[pose.size() / 2]);
  });
  ASSERT_EQ(findings.size(), 1u);
  EXPECT_THAT(findings[0], HasSubstr("frame 9: vertex "));
  EXPECT_THAT(findings[0], HasSubstr("order"));
}

TEST(Jumps, another_order_from_the_first_frame_on_is_noticed_by_its_edges) {
  const auto findings = findings_of([](std::size_t, std::vector<Vec3>& pose) {
    // Every seventh vertex of the old order after the other: a permutation.
    std::vector<Vec3> shuffled;
    for (std::size_t k = 0; k < 7; ++k) {
      for (std::size_t i = k; i < pose.size(); i += 7) shuffled.push_back(pose[i]);
    }
    pose = shuffled;
  });
  ASSERT_EQ(findings.size(), 11u) << "ten lines, and how many more";
  EXPECT_THAT(findings[0], HasSubstr("frame 0: its edges are"));
  EXPECT_EQ(findings[10], "and 14 more frames");
}

TEST(Jumps, smooth_motion_has_none) {
  for (const std::string& name : builtin_names()) {
    const auto clip = builtin_clip(name);
    ASSERT_TRUE(clip);
    JumpFinder jumps((*clip)->rest());
    for (std::size_t t = 0; t < std::min<std::size_t>(40, (*clip)->frame_count()); ++t) jumps.add(*(*clip)->pose(t));
    EXPECT_TRUE(jumps.findings().empty()) << name << ": " << jumps.findings()[0];
  }
}

TEST(Jumps, real_motion_has_none) {
  const std::filesystem::path data = std::filesystem::path(EIGENCAST_DATA_DIR) / "animations";
  if (!std::filesystem::exists(data)) GTEST_SKIP() << "SKIPPED: needs the real inputs in " << data;
  for (const auto& entry : std::filesystem::directory_iterator(data)) {
    const auto clip = open_clip(entry.path().string());
    ASSERT_TRUE(clip) << clip.error().message;
    JumpFinder jumps((*clip)->rest());
    for (std::size_t t = 0; t < (*clip)->frame_count(); ++t) jumps.add(*(*clip)->pose(t));
    EXPECT_TRUE(jumps.findings().empty()) << entry.path() << ": " << jumps.findings()[0];
  }
}

}  // namespace
}  // namespace eigencast
