// SPDX-License-Identifier: MIT
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/surface/formats/clip.h"
#include "common/surface/formats/foreign.h"
#include "common/surface/formats/read.h"
#include "tests/unit/surface/temp_dir.h"

namespace eigencast {
namespace {

using testing::HasSubstr;

// A tetrahedron whose node rises by 3 units within a second.
constexpr const char* kCollada = R"(<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="meter" meter="1"/><up_axis>Y_UP</up_axis></asset>
<library_geometries><geometry id="tetra"><mesh>
<source id="p"><float_array id="pa" count="12">0 0 0 1 0 0 0 1 0 0 0 1</float_array><technique_common>
<accessor source="#pa" count="4" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor>
</technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/><p>0 2 1 0 1 3 0 3 2 1 2 3</p></triangles>
</mesh></geometry></library_geometries>
<library_animations><animation id="rise">
<source id="t"><float_array id="ta" count="2">0 1</float_array>
<technique_common><accessor source="#ta" count="2" stride="1"><param name="TIME" type="float"/></accessor>
</technique_common></source>
<source id="o">
<float_array id="oa" count="32">1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1 1 0 0 0 0 1 0 3 0 0 1 0 0 0 0 1</float_array>
<technique_common><accessor source="#oa" count="2" stride="16"><param name="TRANSFORM" type="float4x4"/></accessor>
</technique_common></source>
<source id="i"><Name_array id="ia" count="2">LINEAR LINEAR</Name_array>
<technique_common><accessor source="#ia" count="2" stride="1"><param name="INTERPOLATION" type="name"/></accessor>
</technique_common></source>
<sampler id="s"><input semantic="INPUT" source="#t"/><input semantic="OUTPUT" source="#o"/>
<input semantic="INTERPOLATION" source="#i"/></sampler>
<channel source="#s" target="node/transform"/>
</animation></library_animations>
<library_visual_scenes><visual_scene id="scene"><node id="node" sid="node" name="node">
<matrix sid="transform">1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</matrix>
<instance_geometry url="#tetra"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#scene"/></scene>
</COLLADA>)";

class Foreign : public testing::Test {
 protected:
  void SetUp() override {
    if (foreign_endings().empty()) GTEST_SKIP() << "built without assimp (libassimp-dev)";
  }
  TempDir dir_;
};

TEST_F(Foreign, ColladaGivesMeshAndAnimation) {
  const auto clip = open_clip(dir_.write("a.dae", kCollada), {.rate_hz = 10});
  ASSERT_TRUE(clip.has_value()) << clip.error().message;
  EXPECT_EQ((*clip)->rest().vertex_count(), 4u);
  EXPECT_EQ((*clip)->rest().faces.size(), 4u);
  ASSERT_EQ((*clip)->frame_count(), 11u);
  const auto first = (*clip)->pose(0), last = (*clip)->pose(10);
  ASSERT_TRUE(first && last);
  for (std::size_t v = 0; v < 4; ++v) {
    EXPECT_NEAR((*last)[v][0], (*first)[v][0], 1e-6);
    EXPECT_NEAR((*last)[v][1], (*first)[v][1] + 3, 1e-5);
  }
}

TEST_F(Foreign, RefusedFilesAreNamed) {
  for (const char* name : {"a.fbx", "a.dae", "a.x", "a.3ds", "a.blend"}) {
    for (const char* bytes : {"", "nonsense", "<COLLADA>", "Kaydara FBX Binary  \0\x1a", "BLENDER_v"}) {
      const auto clip = open_clip(dir_.write(name, bytes));
      ASSERT_FALSE(clip.has_value()) << name << ": " << bytes;
      EXPECT_THAT(clip.error().message, HasSubstr(name));
    }
  }
}

// Every prefix is refused or gives a surface.
TEST_F(Foreign, TruncationsAreErrorsOrValidSurfaces) {
  const std::string whole = kCollada;
  for (std::size_t size = 0; size < whole.size(); size += 97) {
    const auto surface = read_surface(dir_.write("a.dae", whole.substr(0, size)));
    if (surface) {
      EXPECT_GE(surface->vertex_count(), 4u) << size;
    }
  }
}

}  // namespace
}  // namespace eigencast
