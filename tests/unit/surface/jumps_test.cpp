// SPDX-License-Identifier: MIT
#include "common/surface/checks/jumps.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <random>

#include "common/surface/checks/surface_distance.h"
#include "common/surface/checks/vertex_order.h"
#include "common/surface/formats/clip.h"
#include "common/surface/formats/read.h"
#include "common/surface/shapes/shapes.h"
#include "tests/support/paths.h"

namespace eigencast {
namespace {

using Cause = JumpFinder::Cause;

/// The findings in a built-in clip of 24 frames after `change` has had each pose.
template <typename Change>
std::vector<JumpFinder::Finding> findings_of(const Change& change) {
  const auto clip = builtin_clip("torus");
  JumpFinder jumps((*clip)->rest());
  for (std::size_t t = 0; t < 24; ++t) {
    auto pose = *(*clip)->pose(t);
    change(t, pose);
    jumps.add(pose);
  }
  return jumps.found();
}

void expect_one(const std::vector<JumpFinder::Finding>& findings, std::size_t first, std::size_t last, Cause cause) {
  ASSERT_EQ(findings.size(), 1u);
  EXPECT_EQ(findings[0].first, first) << findings[0].text;
  EXPECT_EQ(findings[0].last, last) << findings[0].text;
  EXPECT_EQ(findings[0].cause, cause) << findings[0].text;
}

/// Every seventh vertex of the old order after the other: a permutation.
void shuffle(std::vector<Vec3>& pose) {
  std::vector<Vec3> shuffled;
  for (std::size_t k = 0; k < 7; ++k) {
    for (std::size_t i = k; i < pose.size(); i += 7) shuffled.push_back(pose[i]);
  }
  pose = shuffled;
}

TEST(Jumps, MisplacedFrameIsReportedOnce) {
  const auto findings = findings_of([](std::size_t t, std::vector<Vec3>& pose) {
    for (Vec3& p : pose) p[0] += t == 7 ? 2.0 : 0.0;
  });
  expect_one(findings, 7, 7, Cause::kPosition);
}

TEST(Jumps, SwappedVerticesAreReported) {
  const auto findings = findings_of([](std::size_t t, std::vector<Vec3>& pose) {
    if (t >= 9) std::swap(pose[0], pose[pose.size() / 2]);
  });
  expect_one(findings, 9, 23, Cause::kStray);
}

TEST(Jumps, WrongOrderFromFirstFrameIsReported) {
  const auto findings = findings_of([](std::size_t, std::vector<Vec3>& pose) { shuffle(pose); });
  expect_one(findings, 0, 23, Cause::kOrder);
}

TEST(Jumps, MostFramesInWrongOrderAreRefused) {
  const auto clip = builtin_clip("heart");
  for (const std::size_t wrong : {0u, 12u, 13u, 24u}) {
    JumpFinder jumps((*clip)->rest());
    for (std::size_t t = 0; t < 24; ++t) {
      auto pose = *(*clip)->pose(t);
      if (t < wrong) shuffle(pose);
      jumps.add(pose);
    }
    EXPECT_EQ(jumps.findings().empty(), wrong == 0) << wrong;
    const auto order = jumps.order();
    EXPECT_EQ(bool(order), wrong <= 12) << wrong;
    if (!order) {
      EXPECT_EQ(order.error().code, ErrorCode::kInvalidArgument);
    }
  }
}

TEST(Jumps, MirroredSurfaceIsReported) {
  const auto findings = findings_of([](std::size_t t, std::vector<Vec3>& pose) {
    for (Vec3& p : pose) p[0] *= t >= 20 ? -1 : 1;
  });
  expect_one(findings, 20, 23, Cause::kInsideOut);
}

TEST(Jumps, MisplacedFrameOfThreeIsReported) {
  const auto clip = builtin_clip("torus");
  for (std::size_t elsewhere = 0; elsewhere < 3; ++elsewhere) {
    JumpFinder jumps((*clip)->rest());
    for (std::size_t t = 0; t < 3; ++t) {
      auto pose = *(*clip)->pose(t);
      for (Vec3& p : pose) p[1] += t == elsewhere ? 5 : 0;
      jumps.add(pose);
    }
    expect_one(jumps.found(), elsewhere, elsewhere, Cause::kPosition);
  }
  JumpFinder evenly((*clip)->rest());
  for (std::size_t t = 0; t < 3; ++t) {
    auto pose = *(*clip)->pose(t);
    for (Vec3& p : pose) p[1] += 5 * static_cast<double>(t);
    evenly.add(pose);
  }
  EXPECT_TRUE(evenly.findings().empty()) << "as far each time, it may well fly";
}

TEST(Jumps, FindingsBeyondTheLimitAreCounted) {
  const auto clip = builtin_clip("torus");
  JumpFinder jumps((*clip)->rest());
  for (std::size_t t = 0; t < 24; ++t) {
    auto pose = *(*clip)->pose(t);
    if (t % 2 == 0) shuffle(pose);
    jumps.add(pose);
  }
  EXPECT_EQ(jumps.found().size(), 12u);
  ASSERT_EQ(jumps.findings().size(), 11u) << "ten lines, and how many more";
  EXPECT_EQ(jumps.findings()[10], "and 2 more frames");
}

TEST(Jumps, LikelyCauseIsReported) {
  const auto cause_of = [](const auto& change) {
    const auto findings = findings_of([&](std::size_t t, std::vector<Vec3>& pose) {
      for (Vec3& p : pose) {
        if (t == 7) p = change(p);
      }
    });
    EXPECT_EQ(findings.size(), 1u);
    return findings.empty() ? Cause::kStray : findings[0].cause;
  };
  EXPECT_EQ(cause_of([](const Vec3&) { return Vec3{}; }), Cause::kEmpty);
  EXPECT_EQ(cause_of([](const Vec3& p) { return 100 * p; }), Cause::kUnit);
  EXPECT_EQ(cause_of([](const Vec3& p) { return Vec3{p[0], p[2], -p[1]}; }), Cause::kAxes);
  EXPECT_EQ(cause_of([](const Vec3& p) { return p + Vec3{2, 0, 0}; }), Cause::kPosition);
}

TEST(Jumps, WrongOrderOfTwoFramesIsReported) {
  const auto clip = builtin_clip("torus");
  JumpFinder jumps((*clip)->rest());
  auto pose = *(*clip)->pose(0);
  jumps.add(pose);
  shuffle(pose);
  jumps.add(pose);
  expect_one(jumps.found(), 1, 1, Cause::kOrder);
}

TEST(Jumps, WrongOrderOfRestPoseIsReported) {
  Surface rest = (*builtin_clip("torus"))->rest();
  std::shuffle(rest.positions.begin(), rest.positions.end(), std::mt19937(1));
  const JumpFinder jumps(rest);
  EXPECT_NE(jumps.rest_finding(), "");
  ASSERT_FALSE(jumps.order());
  EXPECT_EQ(jumps.order().error().code, ErrorCode::kInvalidArgument);
}

/// The rest pose, deformed in ways that a surface may be.
std::vector<std::vector<Vec3>> plausible_poses(const Surface& rest) {
  const Box box = bounding_box(rest.positions);
  const double diagonal = box.diagonal();
  std::vector<std::vector<Vec3>> poses(4, rest.positions);
  for (std::size_t i = 0; i < rest.positions.size(); ++i) {
    const Vec3& p = rest.positions[i];
    poses[0][i] = {5 * p[0], p[1], p[2]};
    poses[1][i] = {100 * p[2], 100 * p[0], 100 * p[1]};
    const double turn = 2 * M_PI * (p[1] - box.low[1]) / diagonal;
    poses[2][i] = {p[0] * std::cos(turn) - p[2] * std::sin(turn), p[1], p[0] * std::sin(turn) + p[2] * std::cos(turn)};
    const double near = 1 + 4 * std::exp(-40 * squared_distance(p, rest.positions[0]) / (diagonal * diagonal));
    for (std::size_t c = 0; c < 3; ++c) poses[3][i][c] = rest.positions[0][c] + near * (p[c] - rest.positions[0][c]);
  }
  return poses;
}

TEST(VertexOrder, ShuffledSurfacesAreReportedDeformedOnesPass) {
  const std::filesystem::path data = data_dir() / "meshes";
  for (const char* folder : {"clean", "nasty"}) {
    for (const auto& entry : std::filesystem::directory_iterator(data / folder)) {
      auto surface = read_surface(entry.path().string());
      if (!surface) continue;
      const VertexOrder order(*surface);
      EXPECT_EQ(order.rest().kind, Misfit::Kind::kNone) << entry.path();
      if (surface->faces.size() < 900) continue;
      const bool orderly = std::string_view(folder) == "clean";  // What is torn into rags at rest may look so deformed.
      for (const auto& pose : plausible_poses(*surface)) {
        const Misfit misfit = order.check(pose);
        EXPECT_TRUE(misfit.kind == Misfit::Kind::kNone || (!orderly && misfit.kind == Misfit::Kind::kVertex))
            << entry.path() << ": " << misfit.text();
      }
      std::reverse(surface->positions.begin(), surface->positions.end());
      const Misfit reversed = order.check(surface->positions);
      EXPECT_EQ(reversed.kind, Misfit::Kind::kOrder) << entry.path();
      EXPECT_TRUE(reversed.certain) << entry.path() << ": " << reversed.text();
      EXPECT_TRUE(VertexOrder(*surface).rest().certain) << entry.path();
    }
  }
}

TEST(VertexOrder, OneMisplacedVertexOfARealSurfaceIsReported) {
  const std::filesystem::path data = data_dir() / "animations";
  for (const auto& entry : std::filesystem::directory_iterator(data)) {
    const auto clip = open_clip(entry.path().string());
    ASSERT_TRUE(clip) << clip.error().message;
    const VertexOrder order((*clip)->rest());
    auto pose = *(*clip)->pose((*clip)->frame_count() / 2);
    const double far = 0.05 * bounding_box((*clip)->rest().positions).diagonal();
    for (std::size_t k = 0; k < 20; ++k) {
      const std::size_t v = (k * 7919 + 13) % pose.size();
      pose[v][k % 3] += far;
      const Misfit misfit = order.check(pose);
      EXPECT_EQ(misfit.kind, Misfit::Kind::kVertex) << entry.path() << " vertex " << v;
      EXPECT_EQ(misfit.vertex, v) << entry.path();
      EXPECT_EQ(misfit.others, 0u) << entry.path();
      EXPECT_NEAR(misfit.away, 0.05, 0.03) << entry.path();
      pose[v][k % 3] -= far;
    }
  }
}

TEST(VertexOrder, PointCloudsAndTipsOfFansPass) {
  const Surface cloud{{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, {}};
  EXPECT_EQ(VertexOrder(cloud).check(std::vector<Vec3>(4, Vec3{5, 5, 5})).kind, Misfit::Kind::kNone);
  // A disc of slivers that becomes a tall cone.
  Surface disc{{{0, 0, 0}}, {}};
  for (std::uint32_t i = 0; i < 64; ++i) {
    disc.positions.push_back({std::cos(2 * M_PI * i / 64), std::sin(2 * M_PI * i / 64), 0});
    disc.faces.push_back({0, 1 + i, 1 + (i + 1) % 64});
  }
  const VertexOrder order(disc);
  disc.positions[0][2] = 1;
  EXPECT_EQ(order.check(disc.positions).kind, Misfit::Kind::kNone);
}

TEST(Jumps, SmoothMotionHasNone) {
  for (const std::string& name : builtin_names()) {
    const auto clip = builtin_clip(name);
    ASSERT_TRUE(clip);
    JumpFinder jumps((*clip)->rest());
    for (std::size_t t = 0; t < std::min<std::size_t>(12, (*clip)->frame_count()); ++t) jumps.add(*(*clip)->pose(t));
    EXPECT_TRUE(jumps.findings().empty()) << name << ": " << jumps.findings()[0];
  }
}

TEST(Jumps, RealRigsAndMorphsHaveNone) {
  std::vector<const char*> animations{"Walk", "Run", ""};
  if (has_data("gltf/Fox.glb")) animations.push_back("Survey");
  for (const char* animation : animations) {
    const std::filesystem::path file = *animation != 0 ? rigged_file() : morphing_file();
    const auto clip = open_clip(file.string(), {.animation = animation});
    ASSERT_TRUE(clip) << clip.error().message;
    JumpFinder jumps((*clip)->rest());
    for (std::size_t t = 0; t < (*clip)->frame_count(); ++t) jumps.add(*(*clip)->pose(t));
    EXPECT_TRUE(jumps.findings().empty()) << file << ": " << jumps.findings()[0];
  }
}

TEST(Jumps, RealMotionHasNone) {
  const std::filesystem::path data = data_dir() / "animations";
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
