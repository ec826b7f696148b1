// SPDX-License-Identifier: MIT
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "common/surface/appearance.h"
#include "common/surface/formats/clip.h"
#include "common/surface/formats/read.h"
#include "tests/unit/surface/temp_dir.h"

namespace eigencast {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;
using testing::StartsWith;
using Colours = std::vector<std::array<std::uint8_t, 3>>;

Colours colours_in(const std::string& name, const std::string& bytes) {
  const TempDir dir;
  Appearance appearance;
  const auto surface = read_surface(dir.write(name, bytes), &appearance);
  EXPECT_TRUE(surface) << surface.error().message;
  return surface ? stated_colours(*surface, appearance) : Colours();
}

const Colours kThree{{255, 0, 0}, {0, 128, 0}, {1, 2, 255}};

TEST(Appearance, VertexColoursFromPlyObjAndOff) {
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

TEST(Appearance, PointCloudsHaveColoursToo) {
  EXPECT_EQ(colours_in("cloud.obj", "v 0 0 0 1 0 0\nv 1 0 0 0 .502 0\nv 0 1 0 .00392 .00784 1\n"), kThree);
}

TEST(Appearance, PartialVertexColoursAreDropped) {
  EXPECT_TRUE(colours_in("some.obj", "v 0 0 0 1 0 0\nv 1 0 0\nv 0 1 0 1 1 1\nf 1 2 3\n").empty());
  EXPECT_TRUE(colours_in("weights.obj", "v 0 0 0 1\nv 1 0 0 1\nv 0 1 0 1\nf 1 2 3\n").empty());
  EXPECT_TRUE(colours_in("plain.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").empty());
}

TEST(Appearance, CornerColoursAreMeanLightTimesMaterial) {
  const Surface quad{{{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}}, {{0, 1, 2}, {0, 2, 3}}};
  Appearance appearance;
  appearance.corner_colour = {{{{1, 0, 0, 1}, {0, 1, 0, 1}, {0, 0, 1, 1}}},
                              {{{0, 0, 1, 1}, {0, 0, 1, 1}, {1, 1, 1, 1}}}};
  EXPECT_EQ(stated_colours(quad, appearance), (Colours{{188, 0, 188}, {0, 255, 0}, {0, 0, 255}, {255, 255, 255}}));
  appearance.materials.push_back({"half", {0, 1, 0.2158605F, 1}, -1});
  appearance.face_material = {0, 0};
  EXPECT_EQ(stated_colours(quad, appearance), (Colours{{0, 0, 92}, {0, 255, 0}, {0, 0, 128}, {0, 255, 128}}));
  Appearance grey;
  grey.materials.push_back({"grey", {0.5F, 0.5F, 0.5F, 1}, -1});
  grey.face_material = {0, 0};
  EXPECT_TRUE(stated_colours(quad, grey).empty()) << "nothing to see in one grey";
  grey.materials.push_back({"black", {0, 0, 0, 1}, -1});
  grey.face_material = {0, 1};
  EXPECT_EQ(stated_colours(quad, grey).size(), 4u);
}

/// What an OBJ file of one square says, with what lies beside it.
Appearance appearance_of_square(const TempDir& dir, const std::string& more, const std::string& faces) {
  const std::string name =
      dir.write("square.obj", more + "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 .75\nvt 0 1\n" + faces);
  Appearance appearance;
  const auto surface = read_surface(name, &appearance);
  EXPECT_TRUE(surface) << surface.error().message;
  return appearance;
}

TEST(Appearance, ObjUvsCountFromTheTop) {
  const TempDir dir;
  const Appearance appearance = appearance_of_square(dir, "", "f 1/1 2/2/7 3/3 4/-1\n");
  ASSERT_EQ(appearance.corner_uv.size(), 2u);
  using Uv = std::array<float, 2>;
  EXPECT_EQ(appearance.corner_uv[0], (std::array<Uv, 3>{Uv{0, 1}, Uv{1, 1}, Uv{1, .25F}}));
  EXPECT_EQ(appearance.corner_uv[1], (std::array<Uv, 3>{Uv{0, 1}, Uv{1, .25F}, Uv{0, 0}}));
  const Appearance some = appearance_of_square(dir, "", "f 1/1 2/2 3/3\nf 1 3 4/99\n");
  ASSERT_EQ(some.corner_uv.size(), 2u);
  for (const Uv& uv : some.corner_uv[1]) EXPECT_TRUE(std::isnan(uv[0]) || uv == (Uv{0, 1}));
  EXPECT_TRUE(std::isnan(some.corner_uv[1][2][0])) << "a number beyond the last is nowhere";
  EXPECT_TRUE(appearance_of_square(dir, "", "f 1//1 2 3\n").corner_uv.empty());
}

TEST(Appearance, ObjMaterialsComeFromFilesBelowTheFolder) {
  const TempDir dir;
  dir.write("secret.png", "elsewhere");
  std::filesystem::create_directory(dir.file("model"));
  const TempDir outside;
  outside.write("far.png", "far");
  dir.write("m.mtl",
            "newmtl skin\nKd .8 .8 .8\nmap_Kd -s 1 1 1 skin image.png\nmap_Kd skin.png\n"
            "newmtl red\nKd 1 0 0\n newmtl far\nmap_Kd " +
                outside.file("far.png") + "\n");
  dir.write("skin.png", "pixels");
  const Appearance appearance =
      appearance_of_square(dir, "mtllib m.mtl\nmtllib absent.mtl\n",
                           "usemtl skin\nf 1/1 2/2 3/3\nusemtl red\nf 1 3 4\nusemtl far\nf 1 2 4\n");
  EXPECT_EQ(appearance.face_material, (std::vector<int>{0, 1, 2}));
  ASSERT_EQ(appearance.materials.size(), 3u);
  EXPECT_EQ(appearance.materials[0].name, "skin");
  ASSERT_EQ(appearance.materials[0].image, 0);
  EXPECT_EQ(std::string(appearance.images[0].bytes.begin(), appearance.images[0].bytes.end()), "pixels");
  EXPECT_EQ(appearance.materials[0].base_colour[0], 1) << "an image is not darkened";
  EXPECT_EQ(appearance.materials[1].image, -1);
  EXPECT_EQ(appearance.materials[1].base_colour, (std::array<float, 4>{1, 0, 0, 1}));
  ASSERT_EQ(appearance.materials[2].image, 1);
  EXPECT_TRUE(appearance.images[1].bytes.empty()) << "a file that does not lie below the model's folder is not opened";
}

TEST(Appearance, FilesOfObjThatCannotBeUsedAreNamed) {
  const TempDir dir, outside;
  const std::string start = dir.file("square.obj") + ": ";
  const auto missing = [&](const std::string& library) {
    return appearance_of_square(dir, library, "usemtl skin\nf 1/1 2/2 3/3\nusemtl again\nf 1/1 3/3 4/4\n").missing;
  };
  EXPECT_THAT(missing(""), IsEmpty()) << "materials of no library are not meant to be there";
  EXPECT_THAT(missing("mtllib gone.mtl\n"),
              ElementsAre(AllOf(StartsWith(start), HasSubstr("\"gone.mtl\" is not there"))));
  dir.write("m.mtl", "newmtl skin\nmap_Kd skin.png\nnewmtl again\nmap_Kd skin.png\n");
  EXPECT_THAT(missing("mtllib m.mtl\n"), ElementsAre(AllOf(StartsWith(start), HasSubstr("\"skin.png\" is not there"))))
      << "once for all users";
  dir.write("skin.png", "garbage");
  EXPECT_THAT(missing("mtllib m.mtl\n"), ElementsAre(AllOf(StartsWith(start), HasSubstr("neither PNG nor JPEG"))));
  dir.write("skin.png", "\x89PNG");
  EXPECT_THAT(missing("mtllib m.mtl\n"), IsEmpty());
  EXPECT_THAT(missing("mtllib m.mtl\nmtllib gone.mtl\n"), IsEmpty()) << "every material was found";
  dir.write("coat.png", "\x89PNG");
  dir.write("two.mtl", "newmtl skin\nmap_Kd skin.png\nnewmtl again\nmap_Kd coat.png\n");
  EXPECT_EQ(missing("mtllib two.mtl\n").size(), 1u) << "one image is drawn";
  dir.write("far.mtl", "newmtl skin\nmap_Kd " + outside.write("far.png", "\x89PNG") + "\nnewmtl again\n");
  EXPECT_THAT(missing("mtllib far.mtl\n"), ElementsAre(HasSubstr("below")));
  dir.write("evil.mtl", "newmtl skin\nmap_Kd \x1b[2J" + std::string(5000, 'x') + "\nnewmtl again\n");
  const auto evil = missing("mtllib evil.mtl\n");
  ASSERT_THAT(evil, ElementsAre(AllOf(HasSubstr("\\u001b[2Jx"), Not(HasSubstr("\x1b")))));
  EXPECT_LT(evil[0].size(), start.size() + 200);
  EXPECT_THAT(appearance_of_square(dir, "mtllib gone.mtl\n", "f 1 2 3 4\n").missing, IsEmpty())
      << "no face has a material";
}

TEST(Appearance, SrgbTransferRoundTrips) {
  EXPECT_NEAR(linear_from_srgb(0.5F), 0.21404F, 1e-5);
  for (int i = 0; i < 256; ++i) {
    const float part = static_cast<float>(i) / 255;
    EXPECT_NEAR(srgb_from_linear(linear_from_srgb(part)), part, 1e-6);
  }
}

TEST(Appearance, ClipColoursAreThoseOfTheRestPose) {
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

TEST(Appearance, MaterialsOfTheRestPoseReplaceThoseOfTheFirstFrame) {
  const TempDir dir;
  const std::string square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";
  dir.write("f0.obj", "mtllib gone.mtl\n" + square + "usemtl blue\nf 1 2 3 4\n");
  dir.write("red.mtl", "newmtl red\nKd 1 0 0\n");
  const std::string rest = dir.write("rest.obj", "mtllib red.mtl\n" + square + "usemtl red\nf 1 2 3 4\n");
  const auto clip = open_clip(dir.file("f0.obj"), {.rest = rest});
  ASSERT_TRUE(clip) << clip.error().message;
  EXPECT_THAT((*clip)->appearance()->missing, IsEmpty());
  EXPECT_EQ(stated_colours((*clip)->rest(), *(*clip)->appearance()), Colours(4, {255, 0, 0}));
}

}  // namespace
}  // namespace eigencast
