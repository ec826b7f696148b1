// SPDX-License-Identifier: MIT
#include "common/surface/formats/npy.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "tests/unit/surface/temp_dir.h"

namespace eigencast {
namespace {

template <typename T>
std::string reversed(const std::vector<T>& values) {
  std::string bytes = raw(values);
  for (std::size_t i = 0; i < bytes.size(); i += sizeof(T)) {
    std::reverse(bytes.begin() + static_cast<std::ptrdiff_t>(i),
                 bytes.begin() + static_cast<std::ptrdiff_t>(i + sizeof(T)));
  }
  return bytes;
}

// Value (t, i, c) of an array of (frames, n, 3).
double value(std::size_t t, std::size_t i, std::size_t c) {
  return static_cast<double>(t) * 4 + static_cast<double>(i) + static_cast<double>(c) * 0.25;
}

template <typename T>
std::vector<T> values(std::size_t frames, std::size_t n, bool fortran) {
  std::vector<T> all(frames * n * 3);
  for (std::size_t t = 0; t < frames; ++t) {
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t c = 0; c < 3; ++c) {
        all[fortran ? t + frames * (i + n * c) : (t * n + i) * 3 + c] = static_cast<T>(value(t, i, c));
      }
    }
  }
  return all;
}

void expect_values(const std::string& path, std::size_t frames, std::size_t n) {
  const auto file = NpyFile::open(path);
  ASSERT_TRUE(file) << file.error().message;
  for (const std::size_t t : {frames - 1, std::size_t{0}, frames / 2}) {
    const auto positions = file->read_positions(t);
    ASSERT_TRUE(positions) << positions.error().message;
    ASSERT_EQ(positions->size(), n);
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t c = 0; c < 3; ++c) ASSERT_EQ((*positions)[i][c], value(t, i, c)) << path << " " << t << " " << i;
    }
  }
}

TEST(Npy, MemoryOrderAndByteOrderDoNotMatter) {
  const TempDir dir;
  for (const bool fortran : {false, true}) {
    const std::string order = fortran ? "True" : "False";
    expect_values(dir.write("a.npy", npy("<f4", "(5, 7, 3)", raw(values<float>(5, 7, fortran)), order)), 5, 7);
    expect_values(dir.write("b.npy", npy(">f4", "(5, 7, 3)", reversed(values<float>(5, 7, fortran)), order)), 5, 7);
    expect_values(dir.write("c.npy", npy("<f8", "(5, 7, 3)", raw(values<double>(5, 7, fortran)), order)), 5, 7);
    expect_values(dir.write("d.npy", npy(">f8", "(5, 7, 3)", reversed(values<double>(5, 7, fortran)), order)), 5, 7);
    expect_values(dir.write("e.npy", npy("<f8", "(7, 3)", raw(values<double>(1, 7, fortran)), order)), 1, 7);
  }
}

TEST(Npy, LargeFortranFilesAreReadInBlocks) {
  const TempDir dir;
  // 3 n f8 values of a frame are 6 MiB, so that a block holds five of the 7 frames.
  const std::size_t n = 262'144;
  const std::string path = dir.write("v.npy", npy("<f8", "(7, 262144, 3)", raw(values<double>(7, n, true)), "True"));
  const auto file = NpyFile::open(path);
  ASSERT_TRUE(file);
  for (const std::size_t t : {0u, 4u, 5u, 6u, 3u}) {
    const auto positions = file->read_positions(t);
    ASSERT_TRUE(positions);
    for (const std::size_t i : {std::size_t{0}, n / 2, n - 1}) EXPECT_EQ((*positions)[i][2], value(t, i, 2));
  }
}

TEST(Npy, HalfFloats) {
  const TempDir dir;
  // 1, -2, 0.5; 65504 (largest), 2^-24 (smallest), 0
  const std::vector<std::uint16_t> bits{0x3c00, 0xc000, 0x3800, 0x7bff, 0x0001, 0x8000};
  const auto file = NpyFile::open(dir.write("h.npy", npy("<f2", "(2, 3)", raw(bits))));
  ASSERT_TRUE(file) << file.error().message;
  EXPECT_EQ(*file->read_positions(0), (std::vector<Vec3>{{1, -2, 0.5}, {65504, 0x1p-24, 0}}));
  const auto infinite =
      NpyFile::open(dir.write("i.npy", npy("<f2", "(1, 3)", raw(std::vector<std::uint16_t>{0, 0x7c00, 0}))));
  EXPECT_EQ(infinite->read_positions(0).error().code, ErrorCode::kCorrupt);
}

TEST(Npy, FacesOfEveryIntegerType) {
  const TempDir dir;
  const std::vector<Face> expected{{0, 1, 2}, {0, 2, 100}};
  const auto check = [&](const std::string& type, const std::string& bytes) {
    const auto file = NpyFile::open(dir.write("f.npy", npy(type, "(2, 3)", bytes)));
    ASSERT_TRUE(file) << file.error().message;
    const auto faces = file->read_faces();
    ASSERT_TRUE(faces) << faces.error().message;
    EXPECT_EQ(*faces, expected) << type;
  };
  check("|u1", raw(std::vector<std::uint8_t>{0, 1, 2, 0, 2, 100}));
  check("|i1", raw(std::vector<std::int8_t>{0, 1, 2, 0, 2, 100}));
  check("<u2", raw(std::vector<std::uint16_t>{0, 1, 2, 0, 2, 100}));
  check(">i2", reversed(std::vector<std::int16_t>{0, 1, 2, 0, 2, 100}));
  check(">u4", reversed(std::vector<std::uint32_t>{0, 1, 2, 0, 2, 100}));
  check("<i8", raw(std::vector<std::int64_t>{0, 1, 2, 0, 2, 100}));
  const std::string by_columns = npy("<i4", "(2, 3)", raw(std::vector<std::int32_t>{0, 0, 1, 2, 2, 100}), "True");
  EXPECT_EQ(*NpyFile::open(dir.write("g.npy", by_columns))->read_faces(), expected);
  const auto negative =
      NpyFile::open(dir.write("n.npy", npy("|i1", "(1, 3)", raw(std::vector<std::int8_t>{0, 1, -1}))));
  EXPECT_EQ(negative->read_faces().error().code, ErrorCode::kCorrupt);
}

}  // namespace
}  // namespace eigencast
