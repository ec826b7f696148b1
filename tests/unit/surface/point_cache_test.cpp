// SPDX-License-Identifier: MIT
#include "common/surface/formats/point_cache.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/surface/formats/clip.h"
#include "tests/unit/surface/temp_dir.h"

namespace eigencast {
namespace {

using testing::AllOf;
using testing::HasSubstr;

// Written out here from the formats' descriptions, apart from the code under test: 2 frames of 4 vertices.
const std::vector<float> kValues{0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0.5F, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 2};

std::string big(std::uint32_t v) {
  return {static_cast<char>(v >> 24), static_cast<char>(v >> 16 & 255), static_cast<char>(v >> 8 & 255),
          static_cast<char>(v & 255)};
}
std::string big(float v) {
  return big(std::bit_cast<std::uint32_t>(v));
}

std::string pc2(std::int32_t points = 4, std::int32_t frames = 2, std::int32_t version = 1) {
  return std::string("POINTCACHE2\0", 12) + raw(std::vector<std::int32_t>{version, points}) +
         raw(std::vector<float>{0, 1}) + raw(std::vector<std::int32_t>{frames}) + raw(kValues);
}

std::string mdd(float second = 0.04F, std::uint32_t frames = 2, std::uint32_t points = 4) {
  std::string bytes = big(frames) + big(points) + big(0.0F) + big(second);
  for (const float x : kValues) bytes += big(x);
  return bytes;
}

const char* const kRest = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";

TEST(PointCache, BothFormatsHoldTheSamePoses) {
  const TempDir dir;
  dir.write("clip.obj", kRest);
  for (const std::string& path : {dir.write("clip.pc2", pc2()), dir.write("clip.mdd", mdd())}) {
    const auto clip = open_clip(path);
    ASSERT_TRUE(clip) << clip.error().message;
    EXPECT_EQ((*clip)->rest().faces.size(), 4u);
    ASSERT_EQ((*clip)->frame_count(), 2u);
    EXPECT_EQ((*(*clip)->pose(0)), (std::vector<Vec3>{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}}));
    EXPECT_EQ((*(*clip)->pose(1)), (std::vector<Vec3>{{0.5, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 2}}));
    EXPECT_TRUE((*clip)->notes().empty());
  }
  EXPECT_EQ((*open_clip(dir.file("clip.pc2")))->frame_rate_hz(), 30);
  EXPECT_NEAR((*open_clip(dir.file("clip.mdd")))->frame_rate_hz(), 25, 1e-5);
}

TEST(PointCache, RestMeshByNameOrANote) {
  const TempDir dir;
  const std::string cache = dir.write("clip.pc2", pc2());
  const auto cloud = open_clip(cache);
  ASSERT_TRUE(cloud) << cloud.error().message;
  EXPECT_TRUE((*cloud)->rest().is_point_cloud());
  ASSERT_EQ((*cloud)->notes().size(), 1u);
  EXPECT_THAT((*cloud)->notes()[0], HasSubstr("--rest"));
  const std::string named = dir.write("other.obj", kRest);
  EXPECT_EQ((*open_clip(cache, {named}))->rest().faces.size(), 4u);
  dir.write("rest.obj", kRest);
  EXPECT_EQ((*open_clip(cache))->rest().faces.size(), 4u);
  const std::string small = dir.write("small.obj", std::string(kRest) + "v 9 9 9\n");
  EXPECT_THAT(open_clip(cache, {small}).error().message, AllOf(HasSubstr(" 4 "), HasSubstr(" 5")));
}

TEST(PointCache, NoTimeTableMeansTheDefaultRate) {
  const TempDir dir;
  EXPECT_EQ((*open_clip(dir.write("a.mdd", mdd(0))))->frame_rate_hz(), 30);
  EXPECT_EQ((*open_clip(dir.write("b.mdd", mdd(-1))))->frame_rate_hz(), 30);
}

TEST(PointCache, LyingHeadersAreRefusedBeforeAllocation) {
  const TempDir dir;
  const auto error_of = [&](const std::string& name, const std::string& bytes) {
    const auto clip = open_clip(dir.write(name, bytes));
    EXPECT_FALSE(clip.has_value()) << name;
    return clip ? Error{} : clip.error();
  };
  EXPECT_THAT(error_of("a.pc2", pc2(4, 3)).message, AllOf(HasSubstr("frame 2"), HasSubstr(" 3")));
  EXPECT_EQ(error_of("b.pc2", pc2(16'000'000, 1'000'000)).code, ErrorCode::kCorrupt);
  EXPECT_EQ(error_of("c.pc2", pc2(17'000'000, 1)).code, ErrorCode::kTooLarge);
  EXPECT_EQ(error_of("d.pc2", pc2(4, -1)).code, ErrorCode::kCorrupt);
  EXPECT_EQ(error_of("e.pc2", pc2(0, 2)).code, ErrorCode::kCorrupt);
  EXPECT_EQ(error_of("f.pc2", pc2(4, 2, 2)).code, ErrorCode::kUnsupported);
  EXPECT_EQ(error_of("g.pc2", pc2() + "x").code, ErrorCode::kCorrupt);
  EXPECT_EQ(error_of("h.mdd", mdd(1, 0xffffffff)).code, ErrorCode::kCorrupt);
  EXPECT_EQ(error_of("i.mdd", mdd(1, 1'000'000)).code, ErrorCode::kCorrupt);
  EXPECT_EQ(error_of("j.mdd", "").code, ErrorCode::kCorrupt);
  for (std::size_t cut = 0; cut < pc2().size(); ++cut) error_of("k.pc2", pc2().substr(0, cut));
  for (std::size_t cut = 0; cut < mdd().size(); ++cut) error_of("l.mdd", mdd().substr(0, cut));
}

TEST(PointCache, NonFiniteValueIsReported) {
  const TempDir dir;
  std::string bytes = pc2();
  const float nan = std::numeric_limits<float>::quiet_NaN();
  std::memcpy(bytes.data() + 32 + (12 + 3 * 2) * 4, &nan, 4);
  const auto clip = open_clip(dir.write("n.pc2", bytes));
  ASSERT_TRUE(clip);
  EXPECT_THAT((*clip)->pose(1).error().message, HasSubstr("frame 1 "));
  EXPECT_THAT((*clip)->pose(1).error().message, HasSubstr("vertex 2 "));
}

}  // namespace
}  // namespace eigencast
