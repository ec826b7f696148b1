// SPDX-License-Identifier: MIT
#include "common/surface/formats/gltf.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>

#include "common/surface/checks/check.h"
#include "common/surface/formats/clip.h"
#include "tests/support/paths.h"
#include "tests/unit/surface/glb.h"

namespace eigencast {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::StartsWith;

std::string text(int number) {
  return std::to_string(number);
}

// A tetrahedron of four vertices with its faces.
const std::vector<float> kTetra{0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1};
const std::vector<std::uint16_t> kTetraFaces{0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3};

Result<std::unique_ptr<MotionClip>> open(const std::string& bytes, const ClipOptions& options = {}) {
  return gltf_clip_from_bytes(bytes, "", "test.glb", options);
}

void expect_near(const std::vector<Vec3>& actual, const std::vector<Vec3>& expected) {
  ASSERT_EQ(actual.size(), expected.size());
  for (std::size_t i = 0; i < actual.size(); ++i) {
    for (std::size_t c = 0; c < 3; ++c) EXPECT_NEAR(actual[i][c], expected[i][c], 1e-6) << "vertex " << i;
  }
}

/// A tetrahedron on a node, itself on another, with one animated property of the lower node.
std::string animated(const std::string& path, const std::string& type, std::size_t width,
                     const std::vector<float>& values, const std::string& interpolation,
                     std::vector<float> times = {0, 1}) {
  Glb glb;
  const int position = glb.floats(kTetra, "VEC3", 3);
  const int faces = glb.shorts(kTetraFaces);
  const int offset = glb.floats({0, 0, 0, 2, 0, 0, 0, 0, 0, 0, 0, 0}, "VEC3", 3);
  const int input = glb.floats(times, "SCALAR", 1);
  const int output = glb.floats(values, type, width);
  return glb.bytes(R"("scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"children":[1],"translation":[10,0,0]},{"mesh":0}],)"
                   R"("meshes":[{"primitives":[{"attributes":{"POSITION":)" +
                   text(position) + R"(},"indices":)" + text(faces) + R"(,"targets":[{"POSITION":)" + text(offset) +
                   R"(}]}]}],"animations":[{"name":"a","samplers":[{"input":)" + text(input) + R"(,"output":)" +
                   text(output) + R"(,"interpolation":")" + interpolation +
                   R"("}],"channels":[{"sampler":0,"target":{"node":1,"path":")" + path + R"("}}]}])");
}

TEST(Gltf, NodesMoveMeshesByEachInterpolation) {
  const std::vector<float> there{0, 0, 0, 0, 4, 0};
  const auto linear = open(animated("translation", "VEC3", 3, there, "LINEAR"), {.rate_hz = 4});
  ASSERT_TRUE(linear) << linear.error().message;
  ASSERT_EQ((*linear)->frame_count(), 5u);
  EXPECT_EQ((*linear)->frame_rate_hz(), 4);
  expect_near(*(*linear)->pose(1), {{10, 1, 0}, {11, 1, 0}, {10, 2, 0}, {10, 1, 1}});
  expect_near(*(*linear)->pose(4), {{10, 4, 0}, {11, 4, 0}, {10, 5, 0}, {10, 4, 1}});
  expect_near((*linear)->rest().positions, {{10, 0, 0}, {11, 0, 0}, {10, 1, 0}, {10, 0, 1}});

  const auto step = open(animated("translation", "VEC3", 3, there, "STEP"), {.rate_hz = 4});
  EXPECT_EQ((*(*step)->pose(3))[0], (Vec3{10, 0, 0}));
  EXPECT_EQ((*(*step)->pose(4))[0], (Vec3{10, 4, 0}));

  // Tangents of zero: the Hermite curve 3 t^2 - 2 t^3.
  const auto cubic =
      open(animated("translation", "VEC3", 3, {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 4, 0, 0, 0, 0}, "CUBICSPLINE"),
           {.rate_hz = 4});
  ASSERT_TRUE(cubic) << cubic.error().message;
  EXPECT_NEAR((*(*cubic)->pose(1))[0][1], 4 * (3 * 0.0625 - 2 * 0.015625), 1e-6);
}

TEST(Gltf, RotationsTakeTheShortWayAtEvenSpeed) {
  const auto h = static_cast<float>(std::sqrt(0.5));
  // A quarter turn about z; the second quaternion is negated, which is the same rotation.
  const auto turn = open(animated("rotation", "VEC4", 4, {0, 0, 0, 1, 0, 0, -h, -h}, "LINEAR"), {.rate_hz = 3});
  ASSERT_TRUE(turn) << turn.error().message;
  const double angle = M_PI / 6;
  expect_near(
      *(*turn)->pose(1),
      {{10, 0, 0}, {10 + std::cos(angle), std::sin(angle), 0}, {10 - std::sin(angle), std::cos(angle), 0}, {10, 0, 1}});
  const auto scale = open(animated("scale", "VEC3", 3, {1, 1, 1, 3, 1, 1}, "LINEAR"), {.rate_hz = 2});
  EXPECT_NEAR((*(*scale)->pose(1))[1][0], 12, 1e-6);
}

TEST(Gltf, MorphTargetsAddUpAndAreInTheRig) {
  const auto clip = open(animated("weights", "SCALAR", 1, {0, 1}, "LINEAR"), {.rate_hz = 4});
  ASSERT_TRUE(clip) << clip.error().message;
  expect_near(*(*clip)->pose(1), {{10, 0, 0}, {11.5, 0, 0}, {10, 1, 0}, {10, 0, 1}});
  const Rig* rig = (*clip)->rig();
  ASSERT_NE(rig, nullptr);
  ASSERT_EQ(rig->targets.size(), 1u);
  EXPECT_EQ(rig->targets[0].vertices, std::vector<std::uint32_t>{1});
  EXPECT_EQ(rig->targets[0].offsets, (std::vector<Vec3>{{2, 0, 0}}));
  EXPECT_EQ(rig->bones.size(), 1u) << "a node without a skin is a bone of weight one";
}

/// A tetrahedron on two joints, the second turned by `angle` about z; vertex 1 hangs on both by halves.
std::string skinned(const std::string& joints_of_vertex_3 = "1", const std::string& skin_members = "") {
  Glb glb;
  const int position = glb.floats(kTetra, "VEC3", 3);
  const int faces = glb.shorts(kTetraFaces);
  const auto last = static_cast<std::uint16_t>(std::stoi(joints_of_vertex_3));
  const int joints = glb.shorts({0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, last, 0, 0, 0}, "VEC4", 4);
  const int weights = glb.floats({1, 0, 0, 0, 0.5F, 0.5F, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0}, "VEC4", 4);
  std::vector<float> inverse{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1,
                             1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
  inverse[16 + 12] = -1;  // The second joint stands at x = 1 when the skin is bound.
  const int matrices = glb.floats(inverse, "MAT4", 16);
  const int input = glb.floats({0, 1}, "SCALAR", 1);
  const auto h = static_cast<float>(std::sqrt(0.5));
  const int output = glb.floats({0, 0, 0, 1, 0, 0, h, h}, "VEC4", 4);
  return glb.bytes(R"("nodes":[{"mesh":0,"skin":0,"translation":[100,0,0]},{"children":[2]},{"translation":[1,0,0]}],)"
                   R"("skins":[{"joints":[1,2],"inverseBindMatrices":)" +
                   text(matrices) + skin_members +
                   R"(}],)"
                   R"("meshes":[{"primitives":[{"attributes":{"POSITION":)" +
                   text(position) + R"(,"JOINTS_0":)" + text(joints) + R"(,"WEIGHTS_0":)" + text(weights) +
                   R"(},"indices":)" + text(faces) + R"(}]}],"animations":[{"name":"bend","samplers":[{"input":)" +
                   text(input) + R"(,"output":)" + text(output) +
                   R"(}],"channels":[{"sampler":0,"target":{"node":2,"path":"rotation"}}]}])");
}

TEST(Gltf, SkinsBlendJointsAndIgnoreTheirNode) {
  const auto clip = open(skinned(), {.rate_hz = 1});
  ASSERT_TRUE(clip) << clip.error().message;
  expect_near((*clip)->rest().positions, {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}});
  // A quarter turn about (1, 0): (0, 0, 1) goes to (1, -1, 1); vertex 1 is the joint's own position and stays.
  expect_near(*(*clip)->pose(1), {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, -1, 1}});
  const Rig* rig = (*clip)->rig();
  ASSERT_EQ(rig->bones.size(), 2u);
  ASSERT_EQ(rig->first_influence, (std::vector<std::uint32_t>{0, 1, 3, 4, 5}));
  EXPECT_EQ(rig->influences[1].weight, 0.5);
  EXPECT_EQ(rig->influences[4].weight, 1) << "weights are made to add up to one";
}

TEST(Gltf, PrimitivesMayLackUvsAndColours) {
  Glb glb;
  const int position = glb.floats({0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1}, "VEC3", 3);
  const int uv = glb.floats({0, 0, 1, 0, 0, 1, 1, 1}, "VEC2", 2);
  const int colour = glb.floats({1, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0}, "VEC3", 3);
  const int first = glb.shorts({0, 1, 2}), others = glb.shorts({0, 2, 3, 0, 1, 1, 0, 3, 1});
  const std::string attributes = R"({"attributes":{"POSITION":)" + text(position);
  const auto clip =
      open(glb.bytes(R"("nodes":[{"mesh":0}],"meshes":[{"primitives":[)" + attributes + R"(,"TEXCOORD_0":)" + text(uv) +
                     R"(,"COLOR_0":)" + text(colour) + R"(},"indices":)" + text(first) + "}," + attributes +
                     R"(},"indices":)" + text(others) + "}]}]"));
  ASSERT_TRUE(clip) << clip.error().message;
  ASSERT_EQ((*clip)->rest().faces, (std::vector<Face>{{0, 1, 2}, {0, 2, 3}, {0, 3, 1}}))
      << "one of the three collapses";
  const Appearance* appearance = (*clip)->appearance();
  using Uv = std::array<float, 2>;
  ASSERT_EQ(appearance->corner_uv.size(), 3u);
  EXPECT_EQ(appearance->corner_uv[0], (std::array<Uv, 3>{Uv{0, 0}, Uv{1, 0}, Uv{0, 1}}));
  EXPECT_EQ(appearance->corner_uv[2], (std::array<Uv, 3>{}));
  ASSERT_EQ(appearance->corner_colour.size(), 3u);
  EXPECT_EQ(appearance->corner_colour[2][0], (std::array<float, 4>{1, 1, 1, 1}));
}

TEST(Gltf, BaseColourImagesThatCannotBeUsedAreNamed) {
  const auto missing = [](const std::string& images) {
    Glb glb;
    const int position = glb.floats(kTetra, "VEC3", 3);
    const int faces = glb.shorts(kTetraFaces);
    // Two faces' materials and one that no face has.
    const auto clip =
        open(glb.bytes(R"("nodes":[{"mesh":0}],"meshes":[{"primitives":[{"attributes":{"POSITION":)" + text(position) +
                       R"(},"indices":)" + text(faces) + R"(,"material":0},{"attributes":{"POSITION":)" +
                       text(position) + R"(},"indices":)" + text(faces) + R"(,"material":1}]}],"images":[)" + images +
                       R"(],"textures":[{"source":0},{"source":1}],"materials":[)"
                       R"({"pbrMetallicRoughness":{"baseColorTexture":{"index":0}}},)"
                       R"({"pbrMetallicRoughness":{"baseColorTexture":{"index":0}}},)"
                       R"({"pbrMetallicRoughness":{"baseColorTexture":{"index":1}}}])"));
    EXPECT_TRUE(clip) << clip.error().message;
    return clip ? (*clip)->appearance()->missing : std::vector<std::string>();
  };
  EXPECT_THAT(missing(R"({"uri":"gone.png"},{"uri":"unused.png"})"),
              ElementsAre(AllOf(StartsWith("test.glb: "), HasSubstr("\"gone.png\" is not there"))));
  const std::string garbage = R"({"name":"skin","uri":"data:image/png;base64,Z2FyYmFnZQ=="})";
  EXPECT_THAT(missing(garbage + R"(,{"uri":"unused.png"})"),
              ElementsAre(AllOf(HasSubstr("\"skin\""), HasSubstr("neither PNG nor JPEG"))));
  const std::string png = R"({"uri":"data:image/png;base64,iVBORw=="})";
  EXPECT_THAT(missing(png + R"(,{"uri":"unused.png"})"), IsEmpty());
}

TEST(Gltf, SeamsAreWeldedWhereBothSidesMoveAlike) {
  Glb glb;
  // Three triangles without indices: the edge of the first two is a seam; the third moves with a morph target.
  const int position =
      glb.floats({0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0, 1, 1, 0, 1, 1, 1, 0, 1, 0}, "VEC3", 3);
  const int uv = glb.floats({0, 0, 1, 0, 0, 1, 0.5F, 0, 1, 1, 0, 0.5F, 0, 0, 0, 0, 0, 0}, "VEC2", 2);
  std::vector<float> offsets(27);
  offsets[20] = offsets[23] = offsets[26] = 1;
  const int target = glb.floats(offsets, "VEC3", 3);
  const auto clip =
      open(glb.bytes(R"("nodes":[{"mesh":0}],"meshes":[{"primitives":[{"attributes":{"POSITION":)" + text(position) +
                     R"(,"TEXCOORD_0":)" + text(uv) + R"(},"targets":[{"POSITION":)" + text(target) + "}]}]}]"));
  ASSERT_TRUE(clip) << clip.error().message;
  EXPECT_EQ((*clip)->rest().vertex_count(), 7u) << "two pairs are one; two positions keep two vertices";
  EXPECT_EQ((*clip)->rest().faces, (std::vector<Face>{{0, 1, 2}, {1, 3, 2}, {4, 5, 6}}));
  ASSERT_EQ((*clip)->notes().size(), 2u);
  const Appearance* appearance = (*clip)->appearance();
  ASSERT_EQ(appearance->corner_uv.size(), 3u);
  EXPECT_EQ(appearance->corner_uv[0][1][0], 1) << "both sides of the seam keep their own coordinates";
  EXPECT_EQ(appearance->corner_uv[1][0][0], 0.5F);
}

TEST(Gltf, SparseAndQuantisedAccessorsAreDecoded) {
  Glb glb;
  const int indices = glb.view(raw(std::vector<std::uint16_t>{1, 3}));
  const int values = glb.view(raw(std::vector<float>{1, 0, 0, 0, 0, 1}));
  // No buffer view: zeros, of which two are replaced; with vertex 2 at (0, 0, 0) too there are three positions.
  const int position =
      glb.accessor_json(R"("componentType":5126,"count":4,"type":"VEC3","sparse":{"count":2,"indices":{"bufferView":)" +
                        text(indices) + R"(,"componentType":5123},"values":{"bufferView":)" + text(values) + "}}");
  const int quantised =
      glb.shorts({0, 0, 65535, 65535, 0, 65535, 0, 65535, 65535, 0, 0, 0}, "VEC3", 3, ",\"normalized\":true");
  const auto clip = open(glb.bytes(R"("extensionsRequired":["KHR_mesh_quantization"],"nodes":[{"mesh":0},{"mesh":1}],)"
                                   R"("meshes":[{"primitives":[{"mode":0,"attributes":{"POSITION":)" +
                                   text(position) + R"(}}]},{"primitives":[{"mode":5,"attributes":{"POSITION":)" +
                                   text(quantised) + "}}]}]"));
  ASSERT_TRUE(clip) << clip.error().message;
  EXPECT_EQ((*clip)->rest().positions[1], (Vec3{1, 0, 0}));
  EXPECT_EQ((*clip)->rest().positions[2], (Vec3{0, 0, 1}));
  EXPECT_EQ((*clip)->rest().positions[3], (Vec3{0, 0, 1}));
  EXPECT_EQ((*clip)->rest().positions[4], (Vec3{1, 0, 1}));
  EXPECT_EQ((*clip)->rest().faces, (std::vector<Face>{{3, 4, 5}, {4, 6, 5}})) << "a strip turns every other triangle";
}

/// The error of a file with JSON beside one good position accessor (0) and one of indices (1).
Error error_of(const std::string& members, const std::string& extra_accessor = "") {
  Glb glb;
  glb.floats(kTetra, "VEC3", 3);
  glb.shorts(kTetraFaces);
  if (!extra_accessor.empty()) glb.accessor_json(extra_accessor);
  const auto clip = open(glb.bytes(members));
  EXPECT_FALSE(clip.has_value()) << members << extra_accessor;
  return clip ? Error{} : clip.error();
}

std::string mesh_of(const std::string& primitive) {
  return R"("nodes":[{"mesh":0}],"meshes":[{"primitives":[)" + primitive + "]}]";
}

TEST(Gltf, IndicesAndLengthsAreCheckedBeforeUse) {
  const std::string uses_2 = mesh_of(R"({"attributes":{"POSITION":2},"indices":1})");
  const auto expect_corrupt = [](const Error& error, const std::string& offender) {
    EXPECT_EQ(error.code, ErrorCode::kCorrupt) << error.message;
    EXPECT_THAT(error.message, HasSubstr(offender));
  };
  const auto expect_bad_accessor = [&](const std::string& accessor, const std::string& offender) {
    expect_corrupt(error_of(uses_2, accessor), offender);
  };
  expect_bad_accessor(R"("bufferView":0,"componentType":5126,"count":5,"type":"VEC3")", "buffer view 0");
  expect_bad_accessor(R"("bufferView":9,"componentType":5126,"count":4,"type":"VEC3")", "buffer view 9");
  expect_bad_accessor(
      R"("bufferView":0,"byteOffset":18446744073709551000,"componentType":5126,"count":4,"type":"VEC3")",
      "buffer view 0");
  expect_bad_accessor(R"("bufferView":0,"componentType":5126,"count":4,"type":"VEC2")", "accessor 2");
  EXPECT_EQ(error_of(uses_2, R"("componentType":5126,"count":4000000000000,"type":"VEC3")").code, ErrorCode::kTooLarge);
  expect_bad_accessor(R"("componentType":5126,"count":4,"type":"VEC3","sparse":{"count":2,)"
                      R"("indices":{"bufferView":1,"componentType":5123},"values":{"bufferView":77}})",
                      "buffer view 77");
  expect_corrupt(error_of(mesh_of(R"({"attributes":{"POSITION":7},"indices":1})")), "accessor 7");
  expect_corrupt(error_of(mesh_of(R"({"attributes":{"POSITION":0},"indices":0})")), "accessor 0");
  expect_corrupt(error_of(R"("nodes":[{"mesh":3}],"meshes":[])"), "mesh 3");
  expect_corrupt(error_of(R"("nodes":[{"children":[1]},{"children":[0]}])"), "");
  expect_corrupt(error_of(R"("nodes":[{"children":[2]},{"children":[2]},{}])"), "node 2");
  expect_corrupt(error_of(R"("nodes":[{"children":[9]}])"), "child 9");
  expect_corrupt(open(skinned("7")).error(), "joint 7");
  EXPECT_EQ(error_of(R"("extensionsRequired":["KHR_draco_mesh_compression"])").code, ErrorCode::kUnsupported);
  EXPECT_EQ(error_of(R"("nodes":[{}])").code, ErrorCode::kUnsupported);
  expect_corrupt(error_of("\"extras\":" + std::string(100, '[') + std::string(100, ']')), "");
}

TEST(Gltf, AnimationsAreFoundByNameOrNumber) {
  const std::string bytes = skinned();
  EXPECT_TRUE(open(bytes, {.animation = "bend"}));
  EXPECT_TRUE(open(bytes, {.animation = "0"}));
  const auto none = open(bytes, {.animation = "walk"});
  EXPECT_EQ(none.error().code, ErrorCode::kNotFound);
  EXPECT_THAT(none.error().message, HasSubstr("bend")) << "lists those there are";
  EXPECT_EQ(open(animated("translation", "VEC3", 3, {0, 0, 0, 1, 1, 1}, "LINEAR", {0, 1e30F})).error().code,
            ErrorCode::kTooLarge);
  EXPECT_EQ(open(animated("translation", "VEC3", 3, {0, 0, 0, 1, 1, 1}, "LINEAR", {1, 0})).error().code,
            ErrorCode::kCorrupt);
}

TEST(Gltf, FilesOutsideTheFolderAreNeverOpened) {
  const TempDir dir;
  std::filesystem::create_directory(dir.file("inside"));
  const std::string buffer = raw(kTetra) + raw(kTetraFaces);
  const auto gltf = [&](const std::string& uri) {
    return R"({"asset":{"version":"2.0"},"buffers":[{"byteLength":72,"uri":")" + uri +
           R"("}],"bufferViews":[{"buffer":0,"byteLength":48},{"buffer":0,"byteOffset":48,"byteLength":24}],)"
           R"("accessors":[{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3"},)"
           R"({"bufferView":1,"componentType":5123,"count":12,"type":"SCALAR"}],)" +
           mesh_of(R"({"attributes":{"POSITION":0},"indices":1})") + "}";
  };
  dir.write("outside.bin", buffer);
  dir.write("inside/good.bin", buffer);
  std::filesystem::create_symlink(dir.file("outside.bin"), dir.file("inside/link.bin"));
  const auto opens = [&](const std::string& uri) {
    return open_gltf_clip(dir.write("inside/a.gltf", gltf(uri)), {}).has_value();
  };
  EXPECT_TRUE(opens("good.bin"));
  EXPECT_FALSE(opens("../outside.bin"));
  EXPECT_FALSE(opens("link.bin"));
  EXPECT_FALSE(opens(dir.file("outside.bin")));
  EXPECT_FALSE(opens("http://localhost/outside.bin"));
  EXPECT_FALSE(gltf_clip_from_bytes(gltf("good.bin"), "", "x", {}).has_value()) << "without a folder nothing is read";
}

TEST(Gltf, AloneInAFolderItIsTheClip) {
  const TempDir dir;
  dir.write("notes.txt", "of the fox");
  dir.write("a.glb", skinned());
  const auto alone = open_clip(dir.path());
  ASSERT_TRUE(alone) << alone.error().message;
  EXPECT_NE((*alone)->rig(), nullptr);
  dir.write("b.glb", skinned());
  EXPECT_EQ(open_clip(dir.path()).error().code, ErrorCode::kInvalidArgument);
}

TEST(Gltf, DamagedFilesAreErrorsOrValidSurfaces) {
  const std::string bytes = skinned();
  for (std::size_t cut = 0; cut < bytes.size(); cut += 3) EXPECT_FALSE(open(bytes.substr(0, cut)).has_value()) << cut;
  std::size_t survivors = 0;
  for (std::size_t at = 0; at < bytes.size(); ++at) {
    std::string changed = bytes;
    changed[at] = static_cast<char>(changed[at] ^ (1 << at % 8));
    const auto clip = open(changed);
    if (!clip) continue;
    ++survivors;
    ASSERT_TRUE(validate_surface((*clip)->rest()));
    static_cast<void>((*clip)->pose((*clip)->frame_count() - 1));
  }
  EXPECT_GT(survivors, 0u);
}

TEST(Gltf, RealFiles) {
  EIGENCAST_SKIP_WITHOUT("gltf/Fox.glb");
  const std::string folder = data_dir().string() + "/gltf/";
  const auto fox = open_clip(folder + "Fox.glb", {.animation = "Run"});
  ASSERT_TRUE(fox) << fox.error().message;
  EXPECT_EQ((*fox)->rest().vertex_count(), 290u) << "the data's description: 1,728 welded to 290";
  EXPECT_EQ((*fox)->rest().faces.size(), 576u);
  EXPECT_TRUE(check_surface((*fox)->rest()).closed());
  EXPECT_EQ((*fox)->appearance()->images.size(), 1u);
  EXPECT_GT((*fox)->appearance()->images[0].bytes.size(), 1000u);
  for (std::size_t t = 0; t < (*fox)->frame_count(); ++t) ASSERT_TRUE((*fox)->pose(t));
  const auto cube = open_clip(folder + "AnimatedMorphCube.gltf");
  ASSERT_TRUE(cube) << cube.error().message;
  EXPECT_EQ((*cube)->rig()->targets.size(), 2u);
  EXPECT_EQ((*cube)->rest().vertex_count(), 8u);
  EXPECT_GT((*cube)->frame_count(), 30u);
}

}  // namespace
}  // namespace eigencast
