// SPDX-License-Identifier: MIT
#include "common/surface/jumps.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <random>

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

/// Every seventh vertex of the old order after the other: a permutation.
void shuffle(std::vector<Vec3>& pose) {
  std::vector<Vec3> shuffled;
  for (std::size_t k = 0; k < 7; ++k) {
    for (std::size_t i = k; i < pose.size(); i += 7) shuffled.push_back(pose[i]);
  }
  pose = shuffled;
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
  const auto findings = findings_of([](std::size_t, std::vector<Vec3>& pose) { shuffle(pose); });
  ASSERT_EQ(findings.size(), 1u);
  EXPECT_THAT(findings[0], HasSubstr("frames 0 to 23: edges "));
}

TEST(Jumps, many_are_counted_beyond_ten_lines) {
  const auto torn = findings_of([](std::size_t t, std::vector<Vec3>& pose) {
    if (t % 2 == 0) shuffle(pose);
  });
  ASSERT_EQ(torn.size(), 11u) << "ten lines, and how many more";
  EXPECT_EQ(torn[10], "and 2 more frames");
}

TEST(Jumps, the_likely_cause_is_named) {
  const auto at_frame_7 = [](const auto& change) {
    const auto findings = findings_of([&](std::size_t t, std::vector<Vec3>& pose) {
      for (Vec3& p : pose) {
        if (t == 7) p = change(p);
      }
    });
    EXPECT_EQ(findings.size(), 1u);
    return findings.empty() ? "" : findings[0];
  };
  EXPECT_THAT(at_frame_7([](const Vec3&) { return Vec3{}; }),
              HasSubstr("frame 7: all vertices are in one place; is the frame empty?"));
  EXPECT_THAT(at_frame_7([](const Vec3& p) {
                return Vec3{100 * p[0], 100 * p[1], 100 * p[2]};
              }),
              HasSubstr("times as large as the rest pose; is it in another unit?"));
  EXPECT_THAT(at_frame_7([](const Vec3& p) { return Vec3{p[0], p[2], -p[1]}; }), HasSubstr("are its axes exchanged?"));
  EXPECT_THAT(at_frame_7([](const Vec3& p) {
                return Vec3{p[0] + 2, p[1], p[2]};
              }),
              HasSubstr("is the frame out of place?"));
}

TEST(Jumps, another_order_is_noticed_in_a_clip_of_two_frames) {
  const auto clip = builtin_clip("torus");
  JumpFinder jumps((*clip)->rest());
  auto pose = *(*clip)->pose(0);
  jumps.add(pose);
  shuffle(pose);
  jumps.add(pose);
  ASSERT_EQ(jumps.findings().size(), 1u);
  EXPECT_THAT(jumps.findings()[0], HasSubstr("frame 1: edges "));
}

TEST(Jumps, faces_of_another_order_are_noticed_at_rest) {
  Surface rest = (*builtin_clip("torus"))->rest();
  std::shuffle(rest.positions.begin(), rest.positions.end(), std::mt19937(1));
  const JumpFinder jumps(rest);
  ASSERT_EQ(jumps.findings().size(), 1u) << "whole, but for all its faces";
  EXPECT_THAT(jumps.findings()[0], HasSubstr("rest pose: its faces join"));
}

TEST(Jumps, real_surfaces_are_not_scattered) {
  const std::filesystem::path data = std::filesystem::path(EIGENCAST_DATA_DIR) / "meshes";
  if (!std::filesystem::exists(data)) GTEST_SKIP() << "SKIPPED: needs the real inputs in " << data;
  for (const char* folder : {"clean", "nasty"}) {
    for (const auto& entry : std::filesystem::directory_iterator(data / folder)) {
      const auto surface = read_surface(entry.path().string());
      if (!surface) continue;
      EXPECT_TRUE(JumpFinder(*surface).findings().empty()) << entry.path();
    }
  }
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
