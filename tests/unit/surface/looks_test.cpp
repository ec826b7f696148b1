// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "common/surface/read.h"
#include "common/surface/stated_colours.h"
#include "temp_dir.h"

namespace eigencast {
namespace {

using Colours = std::vector<std::array<std::uint8_t, 3>>;

Colours colours_in(const std::string& name, const std::string& bytes) {
  const TempDir dir;
  Appearance looks;
  const auto surface = read_surface(dir.write(name, bytes), &looks);
  EXPECT_TRUE(surface) << surface.error().message;
  return surface ? stated_colours(*surface, looks) : Colours();
}

const Colours kThree{{255, 0, 0}, {0, 128, 0}, {1, 2, 255}};

TEST(Looks, ColoursOfVerticesComeFromPlyObjAndOff) {
  const std::string head =
      "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n";
  const std::string tail = "element face 1\nproperty list uchar int vertex_indices\nend_header\n";
  const auto channels = [](const std::string& type) {
    return "property " + type + " red\nproperty " + type + " green\nproperty " + type + " blue\n";
  };
  EXPECT_EQ(colours_in("bytes.ply", head + channels("uchar") + "property uchar alpha\n" + tail +
                                        "0 0 0 255 0 0 255\n1 0 0 0 128 0 255\n0 1 0 1 2 255 9\n3 0 1 2\n"),
            kThree);
  EXPECT_EQ(colours_in("parts.ply", head + channels("float") + tail +
                                        "0 0 0 1 0 0\n1 0 0 0 .502 0\n0 1 0 .00392 .00784 7\n3 0 1 2\n"),
            kThree);
  EXPECT_EQ(colours_in("a.obj", "v 0 0 0 1 0 0\nv 1 0 0 0 .502 0\nv 0 1 0 .00392 .00784 1\nf 1 2 3\n"), kThree);
  EXPECT_EQ(colours_in("a.off", "COFF\n3 1 0\n0 0 0 255 0 0 255\n1 0 0 0 128 0 255\n0 1 0 1 2 255 255\n3 0 1 2\n"),
            kThree);
  EXPECT_EQ(colours_in("n.off",
                       "CNOFF\n3 1 0\n0 0 0 0 0 1 1.0 0.0 0.0\n1 0 0 0 0 1 0 .502 0\n"
                       "0 1 0 0 0 1 .00392 .00784 1.0\n3 0 1 2\n"),
            kThree);
}

TEST(Looks, PointCloudsHaveColoursToo) {
  EXPECT_EQ(colours_in("cloud.obj", "v 0 0 0 1 0 0\nv 1 0 0 0 .502 0\nv 0 1 0 .00392 .00784 1\n"), kThree);
}

TEST(Looks, ColoursOfSomeVerticesOnlyAreNone) {
  EXPECT_TRUE(colours_in("some.obj", "v 0 0 0 1 0 0\nv 1 0 0\nv 0 1 0 1 1 1\nf 1 2 3\n").empty());
  EXPECT_TRUE(colours_in("weights.obj", "v 0 0 0 1\nv 1 0 0 1\nv 0 1 0 1\nf 1 2 3\n").empty());
  EXPECT_TRUE(colours_in("plain.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").empty());
}

TEST(Looks, ColoursOfCornersAreTheMeanOfTheirLightTimesTheMaterials) {
  const Surface quad{{{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}}, {{0, 1, 2}, {0, 2, 3}}};
  Appearance looks;
  looks.corner_colour = {{{{1, 0, 0, 1}, {0, 1, 0, 1}, {0, 0, 1, 1}}}, {{{0, 0, 1, 1}, {0, 0, 1, 1}, {1, 1, 1, 1}}}};
  EXPECT_EQ(stated_colours(quad, looks), (Colours{{188, 0, 188}, {0, 255, 0}, {0, 0, 255}, {255, 255, 255}}));
  looks.materials.push_back({"half", {0, 1, 0.2158605F, 1}, -1});
  looks.face_material = {0, 0};
  EXPECT_EQ(stated_colours(quad, looks), (Colours{{0, 0, 92}, {0, 255, 0}, {0, 0, 128}, {0, 255, 128}}));
  Appearance grey;
  grey.materials.push_back({"grey", {0.5F, 0.5F, 0.5F, 1}, -1});
  grey.face_material = {0, 0};
  EXPECT_TRUE(stated_colours(quad, grey).empty()) << "nothing to see in one grey";
}

TEST(Looks, TheTransferOfSrgbGoesThereAndBack) {
  EXPECT_NEAR(linear_from_srgb(0.5F), 0.21404F, 1e-5);
  for (int i = 0; i < 256; ++i) {
    const float part = static_cast<float>(i) / 255;
    EXPECT_NEAR(srgb_from_linear(linear_from_srgb(part)), part, 1e-6);
  }
}

TEST(Looks, AClipsColoursAreThoseOfItsRestPose) {
  const TempDir dir;
  const std::string rest = dir.write(
      "rest.obj", "v 0 0 0 1 0 0\nv 1 0 0 0 .502 0\nv 0 1 0 .00392 .00784 1\nv 0 0 1 1 1 1\nf 1 2 3\nf 1 2 4\n");
  dir.write("f0.off", "OFF\n4 2 0\n0 0 0\n1 0 0\n0 1 0\n0 0 2\n3 0 1 2\n3 0 1 3\n");
  dir.write("f1.off", "OFF\n4 2 0\n0 0 0\n1 0 0\n0 1 0\n0 0 3\n3 0 1 2\n3 0 1 3\n");
  const auto clip = open_clip(dir.file("*.off"), {.rest = rest});
  ASSERT_TRUE(clip) << clip.error().message;
  ASSERT_NE((*clip)->appearance(), nullptr);
  EXPECT_EQ(stated_colours((*clip)->rest(), *(*clip)->appearance()),
            (Colours{{255, 0, 0}, {0, 128, 0}, {1, 2, 255}, {255, 255, 255}}));
}

}  // namespace
}  // namespace eigencast
