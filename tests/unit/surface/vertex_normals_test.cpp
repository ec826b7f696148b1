// SPDX-License-Identifier: MIT
#include "common/surface/vertex_normals.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "common/surface/formats/clip.h"
#include "common/surface/formats/read.h"
#include "common/surface/shapes/shapes.h"
#include "common/surface/vector.h"
#include "tests/unit/surface/glb.h"
#include "tests/unit/surface/temp_dir.h"

namespace eigencast {
namespace {

using enum VertexNormals;
using All = std::vector<VertexNormals>;

Surface cube() {
  Surface s;
  for (const double z : {-1.0, 1.0}) {
    for (const double y : {-1.0, 1.0}) {
      for (const double x : {-1.0, 1.0}) s.positions.push_back({x, y, z});
    }
  }
  s.faces = {{0, 2, 1}, {1, 2, 3}, {4, 5, 6}, {5, 7, 6}, {0, 1, 4}, {1, 5, 4},
             {2, 6, 3}, {3, 6, 7}, {0, 4, 2}, {2, 4, 6}, {1, 3, 5}, {3, 7, 5}};
  return s;
}

Vec3 face_normal(const Surface& s, const Face& f) {
  const Vec3& a = s.positions[f[0]];
  return unit(cross(s.positions[f[1]] - a, s.positions[f[2]] - a));
}

/// The normal of each corner: of its face, or of its vertex, seen from the middle.
using Corners = std::vector<std::array<Vec3, 3>>;
Corners normals_of(const Surface& s, bool flat) {
  Corners corners;
  for (const Face& f : s.faces) {
    auto& mine = corners.emplace_back();
    for (std::size_t k = 0; k < 3; ++k) mine[k] = flat ? face_normal(s, f) : unit(s.positions[f[k]]);
  }
  return corners;
}

std::string words(const Vec3& v) {
  return " " + std::to_string(v[0]) + " " + std::to_string(v[1]) + " " + std::to_string(v[2]) + "\n";
}

/// A normal and texture coordinate for each corner.
std::string obj(const Surface& s, const Corners& normals) {
  std::string text;
  for (const Vec3& p : s.positions) text += "v" + words(p);
  for (std::size_t f = 0; f < s.faces.size(); ++f) {
    std::string face = "f";
    for (std::size_t k = 0; k < 3; ++k) {
      text += "vt 0 0\nvn" + words(normals[f][k]);
      const std::string number = std::to_string(3 * f + k + 1);
      face += " " + std::to_string(s.faces[f][k] + 1) + "/" + number + "/" + number;
    }
    text += face + "\n";
  }
  return text;
}

/// As exporters write it: a vertex for each corner.
std::string glb(const Surface& s, const Corners& normals, const std::string& more_accessors = "") {
  std::vector<float> positions, directions;
  for (std::size_t f = 0; f < s.faces.size(); ++f) {
    for (std::size_t k = 0; k < 3; ++k) {
      for (std::size_t c = 0; c < 3; ++c) {
        positions.push_back(static_cast<float>(s.positions[s.faces[f][k]][c]));
        directions.push_back(static_cast<float>(normals[f][k][c]));
      }
    }
  }
  Glb file;
  const int position = file.floats(positions, "VEC3", 3), normal = file.floats(directions, "VEC3", 3);
  if (!more_accessors.empty()) file.accessor_json(more_accessors);
  const int used = more_accessors.empty() ? normal : normal + 1;
  return file.bytes(R"("nodes":[{"mesh":0}],"meshes":[{"primitives":[{"attributes":{"POSITION":)" +
                    std::to_string(position) + R"(,"NORMAL":)" + std::to_string(used) + "}}]}]");
}

std::string ply(const Surface& s, const Corners& normals) {
  std::string text = "ply\nformat ascii 1.0\nelement vertex " + std::to_string(s.positions.size());
  for (const char* name : {"x", "y", "z", "nx", "ny", "nz"}) text += std::string("\nproperty float ") + name;
  text += "\nelement face " + std::to_string(s.faces.size()) + "\nproperty list uchar int vertex_indices\nend_header\n";
  std::vector<Vec3> of(s.positions.size());
  for (std::size_t f = 0; f < s.faces.size(); ++f) {
    for (std::size_t k = 0; k < 3; ++k) of[s.faces[f][k]] = normals[f][k];
  }
  for (std::size_t v = 0; v < of.size(); ++v) {
    std::string line = words(s.positions[v]);
    line.back() = ' ';
    text += line + words(of[v]);
  }
  for (const Face& f : s.faces)
    text += "3 " + std::to_string(f[0]) + " " + std::to_string(f[1]) + " " + std::to_string(f[2]) + "\n";
  return text;
}

All read(const std::string& name, const std::string& bytes) {
  const TempDir dir;
  Appearance appearance;
  const auto surface = read_surface(dir.write(name, bytes), &appearance);
  EXPECT_TRUE(surface) << surface.error().message;
  EXPECT_TRUE(appearance.vertex_normals.empty() || appearance.vertex_normals.size() == surface->vertex_count());
  return appearance.vertex_normals;
}

TEST(VertexNormals, FlatAndSmoothFilesAreToldApart) {
  const Surface box = cube(), ball = make_icosphere(0);
  EXPECT_EQ(read("hard.obj", obj(box, normals_of(box, true))), All(8, kDiffer));
  EXPECT_EQ(read("smooth.obj", obj(box, normals_of(box, false))), All(8, kAgree));
  EXPECT_EQ(read("hard.glb", glb(box, normals_of(box, true))), All(8, kDiffer)) << "36 vertices welded to 8";
  EXPECT_EQ(read("ball.glb", glb(ball, normals_of(ball, false))), All(12, kAgree));
  EXPECT_EQ(read("ball.obj", obj(ball, normals_of(ball, false))), All(12, kAgree));
  EXPECT_EQ(read("faceted.obj", obj(ball, normals_of(ball, true))), All(12, kDiffer));
  EXPECT_EQ(read("ball.ply", ply(ball, normals_of(ball, false))), All(12, kAgree));
}

TEST(VertexNormals, OneEdgeMayBeHard) {
  const Surface box = cube();
  Corners normals = normals_of(box, false);
  for (std::size_t f : {2U, 3U}) normals[f] = {Vec3{0, 0, 1}, Vec3{0, 0, 1}, Vec3{0, 0, 1}};
  const All expected{kAgree, kAgree, kAgree, kAgree, kDiffer, kDiffer, kDiffer, kDiffer};
  EXPECT_EQ(read("lid.obj", obj(box, normals)), expected);
  EXPECT_EQ(read("lid.glb", glb(box, normals)), expected);
}

TEST(VertexNormals, LengthsSignsAndRoundingDoNotCount) {
  const Surface box = cube();
  Corners normals = normals_of(box, false);
  for (auto& corners : normals) {
    for (Vec3& n : corners) n = -3e30 * n;
  }
  normals[0][0] = {-3, -3.01, -3};
  EXPECT_EQ(read("in.obj", obj(box, normals)), All({kDiffer, kAgree, kAgree, kAgree, kAgree, kAgree, kAgree, kAgree}))
      << "one points outwards";
  normals[0][0] = {3, 3.01, 3};
  EXPECT_EQ(read("in.glb", glb(box, normals)), All(8, kAgree));
}

TEST(VertexNormals, NormalsThatSayNothingAreNone) {
  const Surface box = cube();
  Corners normals = normals_of(box, true);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (const Vec3& all : {Vec3{0, 0, 0}, Vec3{0, 1, 0}, Vec3{nan, 0, 1}}) {
    Corners garbage(normals.size(), {all, all, all});
    EXPECT_TRUE(read("garbage.obj", obj(box, garbage)).empty()) << all[0] << all[1];
    EXPECT_TRUE(read("garbage.glb", glb(box, garbage)).empty()) << all[0] << all[1];
    EXPECT_TRUE(read("garbage.ply", ply(box, garbage)).empty()) << all[0] << all[1];
  }
  normals[0][0] = {nan, 0, 0};
  normals[2][0] = {0, 0, 0};
  const All expected{kNone, kDiffer, kDiffer, kDiffer, kNone, kDiffer, kDiffer, kDiffer};
  EXPECT_EQ(read("gap.obj", obj(box, normals)), expected);
  EXPECT_EQ(read("gap.glb", glb(box, normals)), expected);
}

TEST(VertexNormals, ObjIndicesBeyondTheNormalsAreNone) {
  const std::string head = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 1\nvn 0 0 1\nvn 1 0 0\nvn\n";
  const auto of = [&](const std::string& faces) { return read("a.obj", head + faces); };
  EXPECT_EQ(of("f 1//1 2//1 3//2\nf 1//1 3//2 4//-2\n"), All(4, kAgree)) << "counted back from the last";
  EXPECT_EQ(of("f 1//1 2//9 3//2\nf 1//-4 3//0 4//x\n"), All({kNone, kNone, kNone, kNone}));
  EXPECT_EQ(of("f 1//1 2//1 3//2\nf 1 3/1 4//3\n"), All({kNone, kAgree, kNone, kNone}));
  EXPECT_EQ(of("f 1//99999999999999999999 2//-9223372036854775808 3//4294967297\nf 1//1 3//1 4//2\n"),
            All({kNone, kNone, kNone, kAgree}));
  EXPECT_EQ(read("b.obj", "v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1//1 2//2 3//1\nvn 0 0 1\nvn 1 0 0\n"), All(3, kAgree))
      << "normals may follow";
  EXPECT_TRUE(of("f 1/1 2/1 3/1\n").empty());
}

TEST(VertexNormals, GltfOfAnotherCountIsAnError) {
  const Surface box = cube();
  const TempDir dir;
  const std::string bytes =
      glb(box, normals_of(box, true), R"("bufferView":1,"componentType":5126,"count":3,"type":"VEC3")");
  const auto clip = open_clip(dir.write("a.glb", bytes));
  ASSERT_FALSE(clip);
  EXPECT_EQ(clip.error().code, ErrorCode::kCorrupt);
}

TEST(VertexNormals, ClipsHaveThoseOfTheRestPose) {
  const TempDir dir;
  const Surface box = cube();
  dir.write("f1.obj", obj(box, normals_of(box, true)));
  dir.write("f2.obj", obj(box, normals_of(box, false)));
  const auto first = open_clip(dir.file("*.obj"));
  ASSERT_TRUE(first) << first.error().message;
  EXPECT_EQ((*first)->appearance()->vertex_normals, All(8, kDiffer));
  const auto named = open_clip(dir.file("*.obj"), {.rest = dir.file("f2.obj")});
  ASSERT_TRUE(named) << named.error().message;
  EXPECT_EQ((*named)->appearance()->vertex_normals, All(8, kAgree));
}

}  // namespace
}  // namespace eigencast
