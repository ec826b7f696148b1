// SPDX-License-Identifier: MIT
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>

#include "common/surface/formats/clip.h"
#include "tests/unit/surface/temp_dir.h"

namespace eigencast {
namespace {

using testing::AllOf;
using testing::HasSubstr;

std::string obj(double x, const std::string& faces = "f 1 2 3\nf 1 2 4\n") {
  return "v " + std::to_string(x) + " 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n" + faces;
}

// 3 frames of 4 vertices; the x of vertex 0 is the frame's number.
std::string clip_npy() {
  std::vector<float> values;
  for (int t = 0; t < 3; ++t) {
    for (const float x : {static_cast<float>(t), 0.F, 0.F, 1.F, 0.F, 0.F, 0.F, 1.F, 0.F, 0.F, 0.F, 1.F}) {
      values.push_back(x);
    }
  }
  return npy("<f4", "(3, 4, 3)", raw(values));
}

TEST(NaturalOrder, DigitsCompareAsNumbers) {
  const std::vector<std::string> sorted{"a",    "f",   "f0",   "f00",   "f1",     "f2",
                                        "f02b", "f10", "f10a", "f10a2", "f10a10", "g"};
  std::vector<std::string> shuffled(sorted.rbegin(), sorted.rend());
  std::sort(shuffled.begin(), shuffled.end(), natural_less);
  EXPECT_EQ(shuffled, sorted);
  EXPECT_FALSE(natural_less("f1", "f1"));
  EXPECT_TRUE(natural_less("f99999999999999999999", "f100000000000000000000"));
}

TEST(Clip, DirectoryAndGlobInNaturalOrder) {
  const TempDir dir;
  for (const int i : {10, 9, 2, 1}) dir.write("f" + std::to_string(i) + ".obj", obj(i));
  dir.write("notes.txt", "not a frame");
  for (const std::string& path : {dir.path(), dir.file("f*.obj")}) {
    const auto clip = open_clip(path);
    ASSERT_TRUE(clip.has_value()) << clip.error().message;
    ASSERT_EQ((*clip)->frame_count(), 4u);
    EXPECT_EQ((*clip)->frame_rate_hz(), 30);
    EXPECT_EQ((*clip)->name(), path);
    EXPECT_EQ((*clip)->rest().faces.size(), 2u);
    const double expected[] = {1, 2, 9, 10};
    for (std::size_t i = 0; i < 4; ++i) EXPECT_EQ((*(*clip)->pose(i))[0][0], expected[i]);
  }
}

TEST(Clip, FirstFrameOfOtherTopologyIsReported) {
  const TempDir dir;
  dir.write("f0.obj", obj(0));
  dir.write("f1.obj", obj(1) + "v 2 2 2\n");
  dir.write("f2.obj", obj(2, "f 1 2 3\nf 1 4 2\n"));
  dir.write("f3.obj", obj(3, "f 1 2 3\n"));
  dir.write("f4.obj", "v 0 0\n");
  const auto clip = open_clip(dir.path());
  ASSERT_TRUE(clip.has_value());
  EXPECT_TRUE((*clip)->pose(0).has_value());
  const std::pair<const char*, const char*> expected[] = {{" 5 ", " 4"}, {"(0, 3, 1)", "(0, 1, 3)"}, {" 1 ", " 2"}};
  for (std::size_t i = 1; i < 4; ++i) {
    const auto pose = (*clip)->pose(i);
    ASSERT_FALSE(pose.has_value());
    EXPECT_EQ(pose.error().code, ErrorCode::kInvalidArgument);
    EXPECT_THAT(pose.error().message, HasSubstr("frame " + std::to_string(i)));
    EXPECT_THAT(pose.error().message, HasSubstr("f" + std::to_string(i) + ".obj"));
    EXPECT_THAT(pose.error().message, AllOf(HasSubstr(expected[i - 1].first), HasSubstr(expected[i - 1].second)));
  }
  EXPECT_EQ((*clip)->pose(4).error().code, ErrorCode::kCorrupt);
}

TEST(Clip, NpyWithFacesBesideItNamedOrAtRest) {
  const TempDir dir;
  const std::string vertices = dir.write("vertices.npy", clip_npy());
  const auto cloud = open_clip(vertices);
  ASSERT_TRUE(cloud.has_value()) << cloud.error().message;
  EXPECT_TRUE((*cloud)->rest().is_point_cloud());

  const std::string other = dir.write("other.npy", npy("<i8", "(1, 3)", raw(std::vector<std::int64_t>{0, 1, 2})));
  EXPECT_EQ((*open_clip(vertices, {.faces = other}))->rest().faces, (std::vector<Face>{{0, 1, 2}}));
  const std::string rest = dir.write("rest.obj", obj(7));
  EXPECT_EQ((*open_clip(vertices, {rest}))->rest().faces.size(), 2u);
  EXPECT_EQ((*open_clip(vertices, {rest}))->rest().positions[0][0], 7);
  EXPECT_EQ(open_clip(vertices, {rest, other}).error().code, ErrorCode::kInvalidArgument);

  dir.write("faces.npy", npy("<u4", "(2, 3)", raw(std::vector<std::uint32_t>{0, 1, 2, 0, 1, 3})));
  for (const std::string& path : {vertices, dir.path()}) {
    const auto mesh = open_clip(path);
    ASSERT_TRUE(mesh.has_value()) << mesh.error().message;
    EXPECT_EQ((*mesh)->rest().faces, (std::vector<Face>{{0, 1, 2}, {0, 1, 3}}));
    ASSERT_EQ((*mesh)->frame_count(), 3u);
    for (std::size_t t = 0; t < 3; ++t) EXPECT_EQ((*(*mesh)->pose(t))[0][0], static_cast<double>(t));
  }
}

TEST(Clip, UnsuitableFilesAreRefused) {
  const TempDir dir;
  EXPECT_EQ(open_clip(dir.file("none.npy")).error().code, ErrorCode::kNotFound);
  EXPECT_EQ(open_clip(dir.path()).error().code, ErrorCode::kNotFound);
  EXPECT_EQ(open_clip(dir.file("*.obj")).error().code, ErrorCode::kNotFound);
  dir.write("a.obj", obj(0));
  dir.write("a.off", "OFF\n");
  EXPECT_EQ(open_clip(dir.path()).error().code, ErrorCode::kInvalidArgument);
  const std::string vertices = dir.write("v.npy", clip_npy());
  const std::string wide = dir.write("w.npy", npy("<i4", "(1, 3)", raw(std::vector<std::int32_t>{0, 1, 4})));
  EXPECT_THAT(open_clip(vertices, {.faces = wide}).error().message, HasSubstr("vertex 4"));
  const std::string negative = dir.write("x.npy", npy("<i4", "(1, 3)", raw(std::vector<std::int32_t>{0, 1, -1})));
  EXPECT_EQ(open_clip(vertices, {.faces = negative}).error().code, ErrorCode::kCorrupt);
  const std::string small = dir.write("s.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
  EXPECT_EQ(open_clip(small).error().code, ErrorCode::kInvalidArgument);
  EXPECT_THAT(open_clip(vertices, {small}).error().message, AllOf(HasSubstr(" 4 "), HasSubstr(" 3")));
}

/// A pipe that nobody writes to would never open.
TEST(Clip, WhatIsNoRegularFileIsRefused) {
  const TempDir dir;
  std::filesystem::create_symlink("/dev/null", dir.file("device.obj"));
  EXPECT_THAT(open_clip(dir.file("device.obj")).error().message, HasSubstr("not a regular file"));
}

TEST(Clip, SingleFileIsAClipOfOneFrame) {
  const TempDir dir;
  const auto clip = open_clip(dir.write("one.obj", obj(5)));
  ASSERT_TRUE(clip.has_value());
  EXPECT_EQ((*clip)->frame_count(), 1u);
  EXPECT_EQ(*(*clip)->pose(0), (*clip)->rest().positions);
}

TEST(Clip, FileThatShrinksAfterOpeningIsAnError) {
  const TempDir dir;
  const std::string path = dir.write("v.npy", clip_npy());
  const auto clip = open_clip(path);
  ASSERT_TRUE(clip.has_value());
  std::filesystem::resize_file(path, 150);
  EXPECT_EQ((*clip)->pose(2).error().code, ErrorCode::kIo);
}

}  // namespace
}  // namespace eigencast
