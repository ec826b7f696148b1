// SPDX-License-Identifier: MIT
#include "common/surface/formats/read.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "common/surface/checks/check.h"
#include "tests/unit/surface/temp_dir.h"

namespace eigencast {
namespace {

using testing::HasSubstr;

const std::vector<Vec3> kCorners{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
const std::vector<Face> kFaces{{0, 2, 1}, {0, 1, 3}, {1, 2, 3}, {0, 3, 2}};

const std::string kObj =
    "# tetrahedron\nmtllib /no/such/file.mtl\no t\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvn 0 0 1\nvt 0 0\n"
    "f 1 3 2\nf 1/1 2/1 4/1\nf 2//1 3//1 4//1\nf -4/1/1 -1/1/1 -2/1/1\n";
const std::string kOff = "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n";
const std::string kPlyText =
    "ply\nformat ascii 1.0\ncomment x\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    "property uchar red\nelement face 4\nproperty list uchar int vertex_indices\nend_header\n"
    "0 0 0 9\n1 0 0 9\n0 1 0 9\n0 0 1 9\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n";
const std::string kStlText = [] {
  std::string text = "solid t\n";
  for (const Face& f : kFaces) {
    text += " facet normal 0 0 0\n  outer loop\n";
    for (const std::uint32_t v : f) {
      text += "   vertex";
      for (const double x : kCorners[v]) text += " " + std::to_string(x);
      text += "\n";
    }
    text += "  endloop\n endfacet\n";
  }
  return text + "endsolid t\n";
}();

template <typename T>
std::string swapped(const std::vector<T>& values) {
  std::string bytes = raw(values);
  for (std::size_t i = 0; i < bytes.size(); i += sizeof(T)) {
    std::reverse(bytes.begin() + static_cast<std::ptrdiff_t>(i),
                 bytes.begin() + static_cast<std::ptrdiff_t>(i + sizeof(T)));
  }
  return bytes;
}

// x as double, y and z as float, a list that nobody needs before the faces' indices, another element before the faces.
std::string binary_ply(bool big) {
  std::string bytes = std::string("ply\nformat binary_") + (big ? "big" : "little") +
                      "_endian 1.0\nelement vertex 4\nproperty double x\nproperty float y\nproperty float z\n"
                      "element camera 1\nproperty short n\nelement face 4\nproperty list uchar float texcoord\n"
                      "property list uchar uint vertex_index\nproperty uchar flags\nend_header\n";
  const auto put = [&bytes, big]<typename T>(T value) {
    bytes += big ? swapped(std::vector<T>{value}) : raw(std::vector<T>{value});
  };
  for (const Vec3& p : kCorners) {
    put(p[0]);
    put(static_cast<float>(p[1]));
    put(static_cast<float>(p[2]));
  }
  put(std::int16_t{7});
  for (const Face& f : kFaces) {
    put(std::uint8_t{2});
    put(0.5F);
    put(0.25F);
    put(std::uint8_t{3});
    for (const std::uint32_t v : f) put(v);
    put(std::uint8_t{1});
  }
  return bytes;
}

const std::string kStripHead =
    "element vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    "element tristrips 1\nproperty list int int vertex_indices\nend_header\n";

std::string strip_ply() {
  std::string bytes = "ply\nformat binary_big_endian 1.0\n" + kStripHead;
  for (const Vec3& p : kCorners) {
    for (const double x : p) bytes += swapped(std::vector<float>{static_cast<float>(x)});
  }
  return bytes + swapped(std::vector<std::int32_t>{6, 0, 1, 2, 3, 0, 1});
}

std::string binary_stl() {
  std::string bytes(80, ' ');
  bytes += raw(std::vector<std::uint32_t>{4});
  for (const Face& f : kFaces) {
    bytes += raw(std::vector<float>{0, 0, 0});
    for (const std::uint32_t v : f) {
      for (const double x : kCorners[v]) bytes += raw(std::vector<float>{static_cast<float>(x)});
    }
    bytes += std::string(2, '\0');
  }
  return bytes;
}

std::string positions_npy() {
  std::vector<float> values;
  for (const Vec3& p : kCorners) {
    for (const double x : p) values.push_back(static_cast<float>(x));
  }
  return npy("<f4", "(4, 3)", raw(values));
}

class Read : public testing::Test {
 protected:
  Result<Surface> read(const std::string& name, std::string_view bytes) {
    return read_surface(dir_.write(name, bytes));
  }
  // The message of what must fail; empty if it did not.
  std::string error_of(const std::string& name, std::string_view bytes, ErrorCode code = ErrorCode::kCorrupt) {
    const auto surface = read(name, bytes);
    if (surface) return "";
    EXPECT_EQ(surface.error().code, code) << surface.error().message;
    EXPECT_THAT(surface.error().message, HasSubstr(name));
    return surface.error().message;
  }
  TempDir dir_;
};

TEST_F(Read, EveryFormatGivesTheSameTetrahedron) {
  const std::pair<const char*, std::string> kFiles[] = {{"a.obj", kObj},
                                                        {"b.off", kOff},
                                                        {"c.PLY", kPlyText},
                                                        {"d.ply", binary_ply(false)},
                                                        {"e.ply", binary_ply(true)},
                                                        {"f.obj", "\xEF\xBB\xBF" + std::string(kObj)}};
  testing::internal::CaptureStderr();
  for (const auto& [name, bytes] : kFiles) {
    const auto s = read(name, bytes);
    ASSERT_TRUE(s.has_value()) << s.error().message;
    EXPECT_EQ(s->positions, kCorners) << name;
    EXPECT_EQ(s->faces, kFaces) << name;
  }
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "") << "libraries never print";
}

TEST_F(Read, PlyStripsTurnEveryOtherTriangle) {
  const std::string corners = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n";
  const std::string head = "ply\nformat ascii 1.0\n" + kStripHead + corners;
  const std::vector<Face> around{{0, 1, 2}, {2, 1, 3}, {2, 3, 0}, {0, 3, 1}};
  EXPECT_EQ(read("a.ply", head + "6 0 1 2 3 0 1\n")->faces, around);
  EXPECT_EQ(read("b.ply", head + "13 0 1 2 -1 2 1 3 -1 2 3 0 -1 3\n")->faces,
            (std::vector<Face>{{0, 1, 2}, {2, 1, 3}, {2, 3, 0}}))
      << "-1 ends a strip";
  EXPECT_EQ(read("c.ply", head + "6 0 1 2 2 2 3\n")->faces, (std::vector<Face>{{0, 1, 2}})) << "two vertices only";
  EXPECT_EQ(read("d.ply", strip_ply())->faces, around);
  EXPECT_THAT(error_of("e.ply", head + "4 0 1 2 4\n"), HasSubstr("vertex 4"));
  EXPECT_NE(error_of("f.ply", head + "4 0 1 2 -2\n"), "");
  EXPECT_NE(error_of("g.ply", head + "2000000000 0 1 2 3\n"), "") << "a count that the file cannot hold";
}

TEST_F(Read, StlSharesVerticesInOrderOfAppearance) {
  for (const auto& [name, bytes] : {std::pair{"a.stl", kStlText}, std::pair{"b.stl", binary_stl()}}) {
    const auto s = read(name, bytes);
    ASSERT_TRUE(s.has_value()) << s.error().message;
    EXPECT_EQ(s->positions, (std::vector<Vec3>{{0, 0, 0}, {0, 1, 0}, {1, 0, 0}, {0, 0, 1}}));
    EXPECT_EQ(s->faces.size(), 4u);
    EXPECT_TRUE(check_surface(*s).closed());
  }
}

TEST_F(Read, PositionsAreDoubles) {
  const auto s = read("far.obj", "v 500000.123456789 0 0\nv 1e-50 2 0\nv +3 1.5e3 .5\nf 1 2 3\n");
  ASSERT_TRUE(s.has_value()) << s.error().message;
  EXPECT_EQ(s->positions, (std::vector<Vec3>{{500000.123456789, 0, 0}, {1e-50, 2, 0}, {3, 1500, 0.5}}));
}

TEST_F(Read, NonManifoldAndDegenerateFacesAreKept) {
  // A duplicate face, an edge of four faces, a face with a repeated corner, a quad with one.
  const auto s = read("odd.obj",
                      "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv 5 5 5\nf 1 2 3\nf 1 2 3\nf 1 2 4\nf 2 1 4\nf 1 1 2\n"
                      "f 1 2 2 3\n");
  ASSERT_TRUE(s.has_value()) << s.error().message;
  EXPECT_EQ(s->faces, (std::vector<Face>{{0, 1, 2}, {0, 1, 2}, {0, 1, 3}, {1, 0, 3}, {0, 0, 1}, {0, 1, 1}, {0, 1, 2}}));
  EXPECT_EQ(s->vertex_count(), 5u);
  EXPECT_EQ(check_surface(*s).unreferenced_vertices, 1u);
  EXPECT_EQ(read("odd.off", "OFF 3 1 0\n0 0 0 # a\n1 0 0\n\n0 1 0\n4 0 1 1 2 255 0 0\n")->faces,
            (std::vector<Face>{{0, 1, 1}, {0, 1, 2}}));
}

TEST_F(Read, PolygonsBecomeFansAcrossContinuedLines) {
  const auto s =
      read("poly.obj", "v 0 0 0\r\nv 1 0 0\r\nv 1 1 0\r\nv 0 1 0\r\nv 0 2 0\r\nf 1 2 \\\r\n 3 4 5 # end\r\n");
  ASSERT_TRUE(s.has_value()) << s.error().message;
  EXPECT_EQ(s->faces, (std::vector<Face>{{0, 1, 2}, {0, 2, 3}, {0, 3, 4}}));
}

TEST_F(Read, PointClouds) {
  const std::vector<Vec3> expected{{1, 2, 3}, {4, 5, 6}};
  EXPECT_EQ(read("a.xyz", "# cloud\n1 2 3 0 0 1\n\n4 5 6\n")->positions, expected);
  const auto ply =
      read("b.ply",
           "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n"
           "end_header\n1 2 3\n4 5 6\n");
  ASSERT_TRUE(ply.has_value()) << ply.error().message;
  EXPECT_EQ(ply->positions, expected);
  EXPECT_TRUE(ply->is_point_cloud());
  EXPECT_EQ(read("c.npy", npy("<f8", "(2, 3)", raw(std::vector<double>{1, 2, 3, 4, 5, 6})))->positions, expected);
  EXPECT_EQ(read("d.npy", npy("<f4", "(2, 1, 3)", raw(std::vector<float>{1, 2, 3, 4, 5, 6})))->vertex_count(), 1u);
  EXPECT_EQ(read("e.obj", "v 1 2 3\nv 4 5 6\n")->positions, expected);
}

TEST_F(Read, ErrorsHaveCodeAndPosition) {
  EXPECT_THAT(error_of("a.obj", "v 0 0 0\nv 1 x 0\n"), HasSubstr("line 2"));
  EXPECT_THAT(error_of("b.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"), HasSubstr("line 4"));
  EXPECT_THAT(error_of("c.obj", "v 0 0 0\nf 0 1 1\n"), HasSubstr("line 2"));
  EXPECT_THAT(error_of("d.obj", "v 0 0 0\nf -2 1 1\n"), HasSubstr("line 2"));
  EXPECT_THAT(error_of("e.obj", "v 0 0 nan\n"), HasSubstr("line 1"));
  EXPECT_THAT(error_of("f.obj", "v 0 0 1e300\n"), HasSubstr("line 1"));
  EXPECT_THAT(error_of("g.obj", "v 0 0 0\nf /1 /1 /1\n"), HasSubstr("line 2"));
  EXPECT_THAT(error_of("h.off", "OFF\n4 4 0\n0 0 0\n"), HasSubstr("line 2"));
  EXPECT_THAT(error_of("i.off", "OFF\n1 1 0\n0 0 0\n3 0 1 0\n"), HasSubstr("face 0"));
  EXPECT_THAT(error_of("j.off", "OFF\n1 1 0\n0 0 0\n4294967295 0 0 0\n", ErrorCode::kTooLarge), HasSubstr("line 4"));
  EXPECT_NE(error_of("k.off", "4OFF\n1 1 0\n0 0 0\n", ErrorCode::kUnsupported), "");
  EXPECT_THAT(error_of("l.ply", "ply\nformat ascii 1.0\nelement vertex 999999999\nproperty float x\nend_header\n0\n"),
              HasSubstr("999999999"))
      << "the cap that guards allocation";
  EXPECT_NE(error_of("m.ply", "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n"), "");
  EXPECT_THAT(error_of("n.xyz", "1 2 3\n1 2\n"), HasSubstr("line 2"));
  EXPECT_THAT(error_of("o.stl", "solid\nfacet\nvertex 1 2 3\nendfacet\nendsolid\n"), HasSubstr("line 4"));
  EXPECT_NE(error_of("p.step", "{}", ErrorCode::kUnsupported), "");
  EXPECT_EQ(read_surface(dir_.file("none.obj")).error().code, ErrorCode::kNotFound);
  std::filesystem::create_directory(dir_.file("folder.obj"));
  EXPECT_EQ(read_surface(dir_.file("folder.obj")).error().code, ErrorCode::kIo);
}

TEST_F(Read, NpyErrors) {
  const std::string data = raw(std::vector<float>{1, 2, 3});
  EXPECT_THAT(error_of("a.npy", npy("<f4", "(1000000000000, 1000000000000, 3)", data)), HasSubstr(" 1000000000000 "));
  EXPECT_THAT(error_of("b.npy", npy("<f4", "(999999999, 3)", data)), HasSubstr(" 999999999 "));
  EXPECT_NE(error_of("c.npy", npy("<f4", "(1, 3)", data + "x")), "");
  EXPECT_THAT(error_of("d.npy", npy("<f4", "(-1, 3)", data)), HasSubstr("shape"));
  EXPECT_THAT(error_of("e.npy", npy("<c8", "(1, 3)", data + data), ErrorCode::kUnsupported), HasSubstr("\"'<c8'\""));
  EXPECT_THAT(error_of("f.npy", npy("<f4", "(1, 3)", data, "Maybe")), HasSubstr("fortran_order"));
  EXPECT_NE(error_of("g.npy", npy("<f4", "(3,)", data), ErrorCode::kUnsupported), "");
  EXPECT_NE(error_of("h.npy", npy("<f4", "(0, 3)", "")), "");
  EXPECT_NE(error_of("i.npy", npy("<i4", "(1, 3)", data), ErrorCode::kUnsupported), "");
  EXPECT_THAT(error_of("j.npy", npy("<f4", "(1, 3)", raw(std::vector<float>{1, std::nanf(""), 3}))),
              HasSubstr("vertex 0 of frame 0"));
}

TEST_F(Read, TruncationsAreErrorsOrValidSurfaces) {
  const std::pair<const char*, std::string> kFiles[] = {{"t.obj", kObj},
                                                        {"t.off", kOff},
                                                        {"t.ply", kPlyText},
                                                        {"u.ply", binary_ply(false)},
                                                        {"v.ply", binary_ply(true)},
                                                        {"w.ply", strip_ply()},
                                                        {"t.stl", kStlText},
                                                        {"u.stl", binary_stl()},
                                                        {"t.npy", positions_npy()}};
  for (const auto& [name, bytes] : kFiles) {
    std::size_t errors = 0;
    for (std::size_t length = 0; length < bytes.size(); ++length) {
      const auto s = read(name, std::string_view(bytes).substr(0, length));
      if (!s) {
        ++errors;
        EXPECT_NE(s.error().code, ErrorCode::kInternal) << s.error().message;
        continue;
      }
      EXPECT_LE(s->vertex_count(), 4u) << name << " cut at " << length;
      EXPECT_LE(s->faces.size(), 4u) << name << " cut at " << length;
      for (const Face& f : s->faces) {
        for (const std::uint32_t v : f) EXPECT_LT(v, s->vertex_count());
      }
    }
    EXPECT_GT(errors, 0u) << name;
    ASSERT_TRUE(read(name, bytes).has_value()) << name;
  }
}

TEST_F(Read, ChangedBytesAreErrorsOrValidSurfaces) {
  const std::pair<const char*, std::string> kFiles[] = {{"t.obj", kObj},
                                                        {"t.off", kOff},
                                                        {"t.ply", kPlyText},
                                                        {"u.ply", binary_ply(false)},
                                                        {"v.ply", binary_ply(true)},
                                                        {"w.ply", strip_ply()},
                                                        {"t.stl", kStlText},
                                                        {"u.stl", binary_stl()},
                                                        {"t.npy", positions_npy()}};
  for (const auto& [name, bytes] : kFiles) {
    for (std::size_t at = 0; at < bytes.size(); ++at) {
      for (const char other : {'\0', '\xff', '9', '-', ' '}) {
        std::string changed = bytes;
        changed[at] = other;
        const auto s = read(name, changed);
        if (!s) {
          EXPECT_NE(s.error().code, ErrorCode::kInternal) << s.error().message;
          continue;
        }
        for (const Face& f : s->faces) {
          for (const std::uint32_t v : f) EXPECT_LT(v, s->vertex_count());
        }
      }
    }
  }
}

}  // namespace
}  // namespace eigencast
