// SPDX-License-Identifier: MIT
#include "sdk/bake.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <optional>
#include <set>

#include "common/asset/asset.h"
#include "common/asset/format/reader.h"
#include "common/progressive/prefix.h"
#include "common/reconstruction/reconstruct.h"
#include "common/surface/checks/orientation.h"
#include "common/surface/formats/clip.h"
#include "common/surface/formats/read.h"
#include "common/surface/shapes/shapes.h"
#include "common/surface/vector.h"
#include "tests/support/paths.h"
#include "tests/support/process.h"
#include "tests/unit/sdk/bake_options.h"

namespace eigencast {
namespace {

namespace fs = std::filesystem;
using testing::TemporaryFolder;

/// Source positions from r x 3 coefficients, as a receiver rebuilds them, in the source's order and space.
std::vector<Vec3> rebuild(const Asset& asset, const std::vector<double>& C) {
  std::vector<Vec3> positions(asset.vertex_count);
  for (std::size_t row = 0; row < asset.vertex_count; ++row) {
    Vec3 p = asset.origin;
    for (std::size_t k = 0; k < asset.rank; ++k) {
      for (std::size_t axis = 0; axis < 3; ++axis) p[axis] += double{asset.entry(row, k)} * C[3 * k + axis];
    }
    positions[asset.source_vertex[row]] = p;
  }
  return positions;
}

double worst_distance(const std::vector<Vec3>& a, const std::vector<Vec3>& b) {
  double worst = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    worst = std::max(worst, std::hypot(a[i][0] - b[i][0], a[i][1] - b[i][1], a[i][2] - b[i][2]));
  }
  return worst;
}

void expect_sound(const Surface& surface, const BakeResult& result) {
  const Asset& asset = result.asset;
  const auto valid = validate_asset(asset);
  EXPECT_TRUE(valid) << valid.error().message;
  EXPECT_TRUE(asset.complete());
  EXPECT_EQ(asset.vertex_count, surface.vertex_count());
  EXPECT_EQ(asset.faces.size(), surface.faces.size());
  EXPECT_EQ(asset.band_ends.back(), asset.rank);
  EXPECT_TRUE(result.certified);
  EXPECT_LE(worst_distance(rebuild(asset, asset.rest), surface.positions), 1e-6 * asset.diagonal());
}

TEST(Bake, RestPoseRoundTrips) {
  Surface surface = make_torus(40, 20, 1.0, 0.4);
  for (Vec3& p : surface.positions) p = {p[0] + 100, p[1] - 50, p[2] + 7};
  const auto result = bake(surface, of_rank(60));
  ASSERT_TRUE(result) << result.error().message;
  expect_sound(surface, *result);
  EXPECT_NEAR(result->asset.origin[0], 100, 0.1);
  EXPECT_EQ(result->asset.name, "test");
  EXPECT_EQ(result->asset.basis_kind, "augmented");
  EXPECT_EQ(result->asset.band_ends, (std::vector<std::uint32_t>{14, 54, 60}));
  for (std::size_t k = 4; k < 60; ++k) {
    for (std::size_t axis = 0; axis < 3; ++axis) EXPECT_EQ(result->asset.rest[3 * k + axis], 0);
  }
}

TEST(Bake, LevelsUseReadablePosesOfTheMotion) {
  const Surface surface = make_torus(40, 20, 1.0, 0.4);
  std::set<std::size_t> read;
  const KnownMotion motion{{}, 12, [&](std::size_t i) -> Result<std::vector<Vec3>> {
                             read.insert(i);
                             if (i == 5) return fail(ErrorCode::kIo, "gone");
                             std::vector<Vec3> pose = surface.positions;
                             for (Vec3& p : pose) p[2] += 0.1 * static_cast<double>(i) * p[0] * p[0];
                             if (i == 7) pose[3][1] = std::numeric_limits<double>::quiet_NaN();
                             return pose;
                           }};
  BakeOptions options = of_rank(40);
  const TemporaryFolder cache;
  const auto still = bake(surface, options, cache.path().string());
  options.motion = &motion;
  const auto moving = bake(surface, options, cache.path().string());
  ASSERT_TRUE(still && moving);
  expect_sound(surface, *moving);
  EXPECT_FALSE(moving->from_cache);
  EXPECT_NE(moving->asset.source_vertex, still->asset.source_vertex);
  EXPECT_EQ(read.size(), 6u);
  EXPECT_TRUE(read.contains(5) && read.contains(7)) << "what cannot be read, or is not finite, was met";
  EXPECT_TRUE(bake(surface, options, cache.path().string())->from_cache);
}

TEST(Bake, ARestPoseThatWasMovedRigidlyIsNotBakedAgain) {
  const TemporaryFolder cache;
  const Surface surface = make_torus(40, 20, 1.0, 0.4);
  const auto first = bake(surface, of_rank(60), cache.path().string());
  ASSERT_TRUE(first);
  Surface moved = surface, mirrored = surface, bent = surface;
  for (Vec3& p : moved.positions) {  // as a program of floats has it: a turn by 3-4-5, and a shift
    const Vec3 turned{0.6 * p[0] - 0.8 * p[2] + 3, p[1] - 2, 0.8 * p[0] + 0.6 * p[2] + 7};
    for (std::size_t axis = 0; axis < 3; ++axis) p[axis] = static_cast<float>(turned[axis]);
  }
  for (Vec3& p : mirrored.positions) p[0] = -p[0] + 0.01 * p[1] * p[1] * p[1];
  for (Vec3& p : bent.positions) p[1] += 0.01 * p[0] * p[0];
  const auto found = bake(moved, of_rank(60), cache.path().string());
  ASSERT_TRUE(found);
  EXPECT_TRUE(found->from_cache);
  expect_sound(moved, *found);
  EXPECT_NE(found->encoded.manifest.id, first->encoded.manifest.id);
  EXPECT_NEAR(found->asset.origin[1], -2, 1e-4);
  const auto decoded = decode_asset(found->encoded);
  ASSERT_TRUE(decoded);
  EXPECT_EQ(decoded->rest, found->asset.rest);
  EXPECT_EQ(decoded->origin, found->asset.origin);
  ASSERT_EQ(found->encoded.chunks.size(), first->encoded.chunks.size());
  for (std::size_t i = 0; i < found->encoded.chunks.size(); ++i)
    EXPECT_EQ(found->encoded.chunks[i].id, first->encoded.chunks[i].id);
  for (const Surface* other : {&mirrored, &bent})
    EXPECT_FALSE(bake(*other, of_rank(60), cache.path().string())->from_cache);
  EXPECT_FALSE(bake(moved, of_rank(50), cache.path().string())->from_cache);
}

TEST(Bake, FacesArePermutedSourceFaces) {
  const Surface surface = make_icosphere(2);
  const auto result = bake(surface, of_rank(20));
  ASSERT_TRUE(result);
  const auto sorted = [](Face f) {
    std::rotate(f.begin(), std::min_element(f.begin(), f.end()), f.end());
    return f;
  };
  std::multiset<Face> there;
  for (const Face& f : surface.faces) there.insert(sorted(f));
  std::multiset<Face> baked;
  const auto& source = result->asset.source_vertex;
  for (const Face& f : result->asset.faces) baked.insert(sorted({source[f[0]], source[f[1]], source[f[2]]}));
  EXPECT_EQ(there, baked);
}

TEST(Bake, AssetEqualsItsDecodedBytes) {
  const Surface surface = make_icosphere(2);
  const auto result = bake(surface, of_rank(20));
  ASSERT_TRUE(result);
  const auto decoded = decode_asset(result->encoded);
  ASSERT_TRUE(decoded);
  EXPECT_EQ(decoded->floats, result->asset.floats);
  EXPECT_EQ(decoded->integers, result->asset.integers);
  EXPECT_EQ(decoded->rest, result->asset.rest);
  EXPECT_EQ(result->encoded.manifest.id, sha256(result->encoded.manifest.bytes));
}

TEST(Bake, PointCloudsAndHarmonicBasesAreBaked) {
  Surface cloud = make_torus(40, 20, 1.0, 0.4);
  cloud.faces.clear();
  const auto points = bake(cloud, of_rank(40));
  ASSERT_TRUE(points) << points.error().message;
  expect_sound(cloud, *points);
  EXPECT_TRUE(points->asset.is_point_cloud());
  EXPECT_EQ(points->asset.splats.size(), cloud.positions.size());
  BakeOptions by_kernel = of_rank(40);
  by_kernel.points_operator = PointsOperator::kPbMhb;
  const auto kernel = bake(cloud, by_kernel);
  ASSERT_TRUE(kernel) << kernel.error().message;
  expect_sound(cloud, *kernel);
  EXPECT_EQ(kernel->asset.basis_kind, "augmented");
  EXPECT_EQ(kernel->asset.operator_kind, "pb-mhb");
  const auto harmonic = bake(make_icosphere(3), of_rank(40, BasisKind::kHarmonic));
  ASSERT_TRUE(harmonic);
  EXPECT_EQ(harmonic->asset.basis_kind, "harmonic");
  EXPECT_TRUE(validate_asset(harmonic->asset));
}

TEST(Bake, ErrorsOfLevelsFallAsVerticesCome) {
  Surface cloud = make_torus(80, 40, 1.0, 0.4);
  const auto mesh = bake(cloud, of_rank(10));
  cloud.faces.clear();
  const auto points = bake(cloud, of_rank(10));
  ASSERT_TRUE(mesh && points);
  for (const Asset* asset : {&mesh->asset, &points->asset}) {
    const auto& errors = asset->level_errors;
    ASSERT_EQ(errors.size(), 16u);
    EXPECT_EQ(errors.front().rows, asset->base_count);
    for (const GeometricError& error : errors) EXPECT_LE(error.rms, error.largest);
    for (std::size_t i = 1; i < errors.size(); ++i) EXPECT_LT(errors[i].rms, 1.2F * errors[i - 1].rms);
    EXPECT_LT(errors.back().rms, 0.05F * errors.front().rms);
    // With one vertex in a hundred chords span about a seventh of the tube's circle: 0.4 (1 - cos(pi / 7)) = 0.04.
    EXPECT_GT(errors.front().largest, 0.01F);
    EXPECT_LT(errors.front().largest, 0.2F);
  }
}

TEST(Bake, LevelsOfAFlatSurfaceAreExactUntilItBends) {
  Surface plate;  // of 20 x 20 quads
  constexpr std::uint32_t kSide = 21;
  for (std::uint32_t i = 0; i < kSide * kSide; ++i)
    plate.positions.push_back({0.1 * (i % kSide), 0.1 * (i / kSide), 0});
  for (std::uint32_t i = 0; i + kSide < kSide * kSide; ++i) {
    if (i % kSide == kSide - 1) continue;
    plate.faces.push_back({i, i + 1, i + kSide + 1});
    plate.faces.push_back({i, i + kSide + 1, i + kSide});
  }
  const auto flat = bake(plate, of_rank(10));
  ASSERT_TRUE(flat) << flat.error().message;
  ASSERT_FALSE(flat->asset.level_errors.empty());
  for (const GeometricError& error : flat->asset.level_errors) EXPECT_LT(error.largest, 1e-6F) << error.rows;
  std::vector<Vec3> bent = plate.positions;
  for (Vec3& p : bent) p[2] += 0.2 * std::sin(3 * p[0]);
  const KnownMotion motion{{}, 2, [&](std::size_t) -> Result<std::vector<Vec3>> { return bent; }};
  BakeOptions moving = of_rank(10);
  moving.motion = &motion;
  const auto moved = bake(plate, moving);
  ASSERT_TRUE(moved) << moved.error().message;
  EXPECT_GT(moved->asset.level_errors.front().largest, 1e-3F);
}

/// A torus with bumps that a smooth basis leaves out.
Surface bumpy_torus() {
  Surface surface = make_torus(48, 24, 1, 0.4);
  for (std::size_t i = 0; i < surface.positions.size(); ++i) {
    for (std::size_t axis = 0; axis < 3; ++axis)
      surface.positions[i][axis] += (axis == i % 3 ? 0.02 : 0.01) * std::sin(40.0 * static_cast<double>(i));
  }
  return surface;
}
BakeOptions with_detail(DetailKind detail) {
  BakeOptions options = of_rank(60, BasisKind::kHarmonic);
  options.detail = detail;
  return options;
}
/// Returns it as receivers rebuild it, in rows' order, in the asset's space.
std::vector<float> received(const Asset& asset, const std::vector<double>& C, std::uint32_t N) {
  Reconstructor reconstructor;
  reconstructor.update(asset);
  std::vector<float> positions(std::size_t{3} * N);
  reconstructor.rebuild(C, 3, asset.rank, N, positions);
  return positions;
}
double worst_distance(const Surface& source, const Asset& asset, const std::vector<float>& rows) {
  double worst = 0;
  for (std::size_t i = 0; i < rows.size() / 3; ++i) {
    const Vec3& truth = source.positions[asset.source_vertex[i]];
    const auto off = [&](std::size_t d) { return double{rows[3 * i + d]} + asset.origin[d] - truth[d]; };
    worst = std::max(worst, std::hypot(off(0), off(1), off(2)));
  }
  return worst;
}

TEST(BakeDetail, FramesRestoreTheRestPoseAtEveryLevel) {
  for (const bool cloud : {false, true}) {
    Surface surface = bumpy_torus();
    if (cloud) surface.faces.clear();
    const auto frames = bake(surface, of_rank(60, BasisKind::kHarmonic)),
               none = bake(surface, with_detail(DetailKind::kNone)),
               normal = bake(surface, with_detail(DetailKind::kNormal));
    ASSERT_TRUE(frames && none && normal);
    const Asset& asset = frames->asset;
    EXPECT_EQ(detail_of(asset), DetailKind::kFrames) << "what a harmonic basis is baked with";
    EXPECT_EQ(detail_of(none->asset), DetailKind::kNone);
    EXPECT_EQ(detail_of(normal->asset), DetailKind::kNormal);
    EXPECT_LT(frames->encoded.total_bytes(), 4 * none->encoded.total_bytes());
    const auto worst_of = [&](const BakeResult& result) {
      return worst_distance(surface, result.asset, received(result.asset, result.asset.rest, asset.vertex_count));
    };
    EXPECT_GT(worst_of(*none), 0.02);
    EXPECT_LT(worst_of(*normal), 0.95 * worst_of(*none));
    EXPECT_LT(worst_of(*frames), 2e-3 * worst_of(*none));

    const std::vector<float> full = received(asset, asset.rest, asset.vertex_count);
    for (const std::uint32_t N : {asset.base_count, asset.vertex_count / 3})
      EXPECT_TRUE(std::equal(full.begin(), full.begin() + 3 * N, received(asset, asset.rest, N).begin()));
    // A quarter turn round z, and stretched: rotations of the frames, and of them alone.
    std::vector<double> turned = asset.rest;
    for (std::size_t k = 0; k < asset.rank; ++k) {
      turned[3 * k] = -asset.rest[3 * k + 1];
      turned[3 * k + 1] = asset.rest[3 * k];
    }
    const std::vector<float> now = received(asset, turned, asset.vertex_count);
    for (std::size_t i = 0; i < full.size(); i += 3) {
      ASSERT_NEAR(now[i], -full[i + 1], 1e-4F);
      ASSERT_NEAR(now[i + 1], full[i], 1e-4F);
      ASSERT_NEAR(now[i + 2], full[i + 2], 1e-4F);
    }
  }
}

TEST(BakeDetail, NormalsEqualThoseAtFullDetail) {
  const Surface surface = bumpy_torus();
  const auto baked = bake(surface, with_detail(DetailKind::kFrames));
  ASSERT_TRUE(baked) << baked.error().message;
  const Asset& asset = baked->asset;
  Reconstructor reconstructor;
  reconstructor.update(asset);
  const std::size_t count = std::size_t{3} * asset.vertex_count;
  std::vector<float> positions(count), normals(count), of_faces(count);
  const PoseToRebuild pose{asset.rest, 3, positions, normals};
  reconstructor.rebuild({&pose, 1}, asset.rank, asset.vertex_count);
  vertex_normals(positions, triangles_at_level(asset, asset.vertex_count), of_faces);
  for (std::size_t i = 0; i < count; i += 3) {
    const float cosine = normals[i] * of_faces[i] + normals[i + 1] * of_faces[i + 1] + normals[i + 2] * of_faces[i + 2];
    EXPECT_GT(cosine, 0.999F) << i / 3;
  }
}

TEST(BakeDetail, BasisWithTheRestPoseRefusesDetail) {
  BakeOptions options = of_rank(60);
  options.detail = DetailKind::kFrames;
  const auto refused = bake(make_icosphere(2), options);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kInvalidArgument);
  options.detail = DetailKind::kNone;
  EXPECT_TRUE(bake(make_icosphere(2), options));
}

TEST(Bake, UnstreamableSurfacesAreRefused) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  const std::vector<Face> face = {{0, 1, 2}};
  const std::vector<Surface> surfaces = {
      {},
      {{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, face},   // three vertices
      {std::vector<Vec3>(10, Vec3{1, 1, 1}), {}},  // all at one point
      {std::vector<Vec3>(10, Vec3{1, 1, 1}), face},
      {{{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {3, 0, 0}}, face},  // no area
      {{{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {3, 0, 0}, {9, 0, 0}}, {}},
      {{{0, 0, 0}, {1, 0, 0}, {0, kNan, 0}, {3, 0, 0}}, face},
      {{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {3, 0, 0}}, {{0, 1, 4}}},  // a vertex that is not there
      {{{0, 0, 0}, {0.1, 0.1, 0.1}, {0.2, 0.2, 0.2}, {0.7, 0.7, 0.7}}, face},
      {{{0, 0, 0}, {1e30, 0, 0}, {0, 1e30, 0}, {0, 0, 1e30}}, face},  // numbers of 32 bits do not hold its area
      {{{0, 0, 0}, {1e-30, 0, 0}, {0, 1e-30, 0}, {0, 0, 1e-30}}, face},
  };
  for (std::size_t i = 0; i < surfaces.size(); ++i) {
    const auto result = bake(surfaces[i], of_rank(20));
    ASSERT_FALSE(result) << i;
    EXPECT_TRUE(result.error().code == ErrorCode::kInvalidArgument || result.error().code == ErrorCode::kNumerical)
        << i;
    EXPECT_FALSE(result.error().message.empty());
  }
}

TEST(Bake, InvalidOptionsAreRefused) {
  const Surface surface = make_icosphere(1);
  for (const BakeOptions& options : {of_rank(0), of_rank(-5), of_rank(5000)}) {
    const auto result = bake(surface, options);
    ASSERT_FALSE(result);
    EXPECT_EQ(result.error().code, ErrorCode::kInvalidArgument);
  }
  BakeOptions of_points = of_rank(20);
  of_points.points_operator = PointsOperator::kPbMhb;
  const auto result = bake(surface, of_points);  // of a surface with faces
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kInvalidArgument);
}

TEST(Bake, RankIsLoweredToTheVertices) {
  const auto result = bake(make_icosphere(1), of_rank(200));
  ASSERT_TRUE(result);
  EXPECT_EQ(result->asset.rank, 20U);
  EXPECT_EQ(result->asset.vertex_count, 42U);
}

TEST(Bake, ColoursStayWithTheirVertices) {
  const TemporaryFolder folder;
  const Surface surface = make_icosphere(2);
  Appearance appearance;
  for (std::size_t i = 0; i < surface.vertex_count(); ++i)
    appearance.vertex_colour.push_back({static_cast<std::uint8_t>(i), 7, static_cast<std::uint8_t>(3 * i)});
  BakeOptions options = of_rank(20);
  const auto plain = bake(surface, options, folder.path());
  options.appearance = &appearance;
  for (const bool again : {false, true}) {
    const auto result = bake(surface, options, folder.path());
    ASSERT_TRUE(result);
    EXPECT_EQ(result->from_cache, again) << "not to be mistaken for the surface without colours";
    ASSERT_EQ(result->asset.colours.size(), surface.vertex_count());
    for (std::size_t row = 0; row < result->asset.colours.size(); ++row)
      EXPECT_EQ(result->asset.colours[row], appearance.vertex_colour[result->asset.source_vertex[row]]);
  }
  appearance.vertex_colour.clear();
  const auto empty = bake(surface, options, folder.path());
  EXPECT_TRUE(empty && plain && empty->from_cache) << "appearance that say nothing change nothing";
}

TEST(Bake, NormalsStayWithTheirVertices) {
  const TemporaryFolder folder;
  const Surface surface = make_icosphere(2);
  Appearance appearance;
  for (std::size_t i = 0; i < surface.vertex_count(); ++i)
    appearance.vertex_normals.push_back(static_cast<VertexNormals>(i % 3));
  BakeOptions options = of_rank(20);
  const auto plain = bake(surface, options, folder.path());
  ASSERT_TRUE(plain);
  EXPECT_TRUE(plain->asset.normals.empty());
  options.appearance = &appearance;
  for (const bool again : {false, true}) {
    const auto result = bake(surface, options, folder.path());
    ASSERT_TRUE(result);
    EXPECT_EQ(result->from_cache, again) << "not to be mistaken for the surface without normals";
    ASSERT_EQ(result->asset.normals.size(), surface.vertex_count());
    for (std::size_t row = 0; row < result->asset.normals.size(); ++row)
      EXPECT_EQ(result->asset.normals[row], result->asset.source_vertex[row] % 3);
  }
}

TEST(Bake, OneTextureGoesWithTheAsset) {
  const TemporaryFolder folder;
  const Surface surface = make_icosphere(2);
  Appearance appearance;
  for (const Face& face : surface.faces) {
    std::array<std::array<float, 2>, 3> corners{};
    for (std::size_t k = 0; k < 3; ++k) {
      const Vec3& p = surface.positions[face[k]];
      corners[k] = {static_cast<float>(std::atan2(p[1], p[0])), static_cast<float>(p[2])};
    }
    appearance.corner_uv.push_back(corners);
    appearance.face_material.push_back(appearance.corner_uv.size() % 4 == 0 ? 1 : 0);
  }
  appearance.images = {{"most.png", "image/png", {0x89, 'P', 'N', 'G', 7}},
                       {"few.jpg", "image/jpeg", {0xff, 0xd8, 0xff, 8}},
                       {"never.bmp", "image/bmp", {1}}};
  appearance.materials = {{"a", {1, 1, 1, 1}, 0}, {"b", {1, 1, 1, 1}, 1}, {"c", {1, 1, 1, 1}, 2}};
  BakeOptions options = of_rank(20);
  const auto plain = bake(surface, options, folder.path());
  options.appearance = &appearance;
  for (const bool again : {false, true}) {
    const auto result = bake(surface, options, folder.path());
    ASSERT_TRUE(result) << result.error().message;
    EXPECT_EQ(result->from_cache, again);
    const Asset& asset = result->asset;
    ASSERT_NE(asset.texture, nullptr);
    EXPECT_EQ(asset.texture->image, appearance.images[0].bytes);
    std::size_t nowhere = 0;
    for (std::size_t f = 0; f < asset.faces.size(); ++f) {
      for (std::size_t k = 0; k < 3; ++k) {
        const std::uint32_t wedge = asset.texture->corners[f][k];
        if (asset.texture->uvs[wedge] == AssetTexture::kNone) {
          ++nowhere;
          continue;
        }
        const Vec3& p = surface.positions[asset.source_vertex[asset.faces[f][k]]];
        EXPECT_NEAR(asset.texture->uv(wedge)[1], p[2], 1e-4);
        EXPECT_NEAR(std::remainder(asset.texture->uv(wedge)[0] - std::atan2(p[1], p[0]), 2 * M_PI), 0, 2e-4);
      }
    }
    EXPECT_EQ(nowhere, 3 * (surface.faces.size() / 4)) << "those of the other image";
  }
  appearance.images[0].bytes.clear();
  const auto second = bake(surface, options, folder.path());
  ASSERT_TRUE(second && second->asset.texture);
  EXPECT_EQ(second->asset.texture->image, appearance.images[1].bytes);
  Surface contradictory = surface;
  std::vector<bool> turned(surface.faces.size());
  for (std::size_t f = 0; f < turned.size(); ++f) turned[f] = f % 3 == 1;
  turn_faces(turned, contradictory.faces);
  turn_faces(turned, appearance.corner_uv);
  const auto third = bake(contradictory, options, folder.path());
  ASSERT_TRUE(third) << third.error().message;
  EXPECT_TRUE(third->from_cache);
  EXPECT_EQ(third->encoded.manifest.id, second->encoded.manifest.id) << "faces are turned back with their corners";
}

TEST(Bake, CanBeStoppedAtEveryStage) {
  const Surface surface = make_icosphere(3);
  std::set<std::string> stages;
  double last = 0;
  ASSERT_TRUE(bake(surface, of_rank(40), {}, [&](double fraction, std::string_view stage) {
    EXPECT_GE(fraction, last);
    EXPECT_LE(fraction, 1);
    last = fraction;
    stages.emplace(stage);
    return true;
  }));
  EXPECT_EQ(last, 1);
  EXPECT_EQ(stages, (std::set<std::string>{"augmenting", "checking", "done", "eigenvectors", "encoding",
                                           "levels of detail", "operator"}));
  stages.erase("done");
  for (const std::string& stop : stages) {
    const auto result = bake(surface, of_rank(40), {}, [&](double, std::string_view stage) { return stage != stop; });
    ASSERT_FALSE(result) << stop;
    EXPECT_EQ(result.error().code, ErrorCode::kCancelled) << stop;
  }
}

/// What a basis leaves out of a clip.
double missed_by(const Asset& asset, const MotionClip& clip) {
  const auto projector = Projector::create(asset);
  EXPECT_TRUE(projector);
  double squares = 0;
  for (std::size_t frame = 0; projector && frame < clip.frame_count(); frame += 4) {
    const auto pose = clip.pose(frame);
    EXPECT_TRUE(pose);
    const auto C =
        projector->coefficients_from_positions(std::span<const double>(pose->front().data(), 3 * pose->size()));
    EXPECT_TRUE(C);
    const std::vector<Vec3> rebuilt = rebuild(asset, *C);
    for (std::size_t i = 0; i < rebuilt.size(); ++i) squares += std::pow(length(rebuilt[i] - (*pose)[i]), 2);
  }
  return std::sqrt(squares);
}

TEST(Bake, FirstPosesMissATenthMoreThanExactOnesAtMost) {
  const auto clip = open_clip(gait_clip().string());
  ASSERT_TRUE(clip) << clip.error().message;
  std::optional<Asset> first;
  BakeOptions options = of_rank(60);
  options.first = [&](BakeResult& made) { first = std::move(made.asset); };
  ASSERT_TRUE(bake((*clip)->rest(), options));
  if (!first) GTEST_SKIP() << "the clip has so few vertices that no basis goes first";
  const auto exact = bake((*clip)->rest(), of_rank(static_cast<int>(first->rank)));
  ASSERT_TRUE(exact);
  EXPECT_LE(missed_by(*first, **clip), 1.1 * missed_by(exact->asset, **clip));
}

TEST(Bake, HostileSurfacesAreBakedOrRefused) {
  const fs::path data = data_dir();
  std::size_t baked = 0, files = 0;
  for (const char* folder : {"meshes/nasty", "clouds"}) {
    for (const auto& entry : fs::directory_iterator(data / folder)) {
      const auto surface = read_surface(entry.path().string());
      ASSERT_TRUE(surface) << surface.error().message;
      ++files;
      const auto result = bake(*surface, of_rank(30));
      if (!result) {
        EXPECT_FALSE(result.error().message.empty());
        continue;
      }
      ++baked;
      SCOPED_TRACE(entry.path());
      expect_sound(*surface, *result);
    }
  }
  EXPECT_GE(baked + 2, files);
}

TEST(Bake, AssetsHoldTheHalfContractions) {
  const auto baked = bake(make_icosphere(3), {.basis = BasisKind::kHarmonic, .rank = 20, .name = {}});
  ASSERT_TRUE(baked) << baked.error().message;
  const auto asset = decode_asset(baked->encoded);
  ASSERT_TRUE(asset) << asset.error().message;
  for (std::uint32_t N = asset->vertex_count; N > asset->base_count; --N) {
    ASSERT_EQ(prefix_face_count(asset->death, N), prefix_face_count(asset->death, N - 1) + 2)
        << "a closed manifold loses two faces with each vertex";
  }
}

}  // namespace
}  // namespace eigencast
