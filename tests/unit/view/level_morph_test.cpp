// SPDX-License-Identifier: MIT
#include "common/reconstruction/level_morph.h"

#include <epoxy/gl.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <tuple>
#include <utility>

#include "common/asset/format/encode.h"
#include "common/asset/format/reader.h"
#include "common/reconstruction/level_triangles.h"
#include "tests/unit/view/baked_heart.h"
#include "tests/unit/view/offscreen_pictures.h"
#include "view/surface_view.h"

namespace eigencast {
namespace {

using testing::baked_heart;

constexpr TimeUs kFrame = 16'667;

TEST(LevelTriangles, AnyWalkGivesTheLevelsTriangles) {
  const Asset& asset = baked_heart();
  LevelTriangles levels;
  std::vector<std::uint32_t> triangles, copy;
  EXPECT_TRUE(levels.update(asset, triangles));
  std::uint64_t copied = 0;
  std::mt19937 random(5);
  std::uniform_int_distribution<std::uint32_t> any(asset.base_count, asset.vertex_count), near(0, 40);
  for (int i = 0; i < 60; ++i) {
    const std::uint32_t N =
        i % 3 == 0 ? any(random) : std::clamp(levels.level() + near(random) - 20, asset.base_count, asset.vertex_count);
    levels.set_level(N, triangles);
    ASSERT_EQ(triangles, triangles_at_level(asset, N)) << "level " << N;
    // Copying only what is said to have changed gives the same.
    copy.resize(triangles.size());
    const auto& blocks = levels.block_versions();
    ASSERT_EQ(blocks.size(), (triangles.size() + LevelTriangles::kBlock - 1) / LevelTriangles::kBlock);
    for (std::size_t b = 0; b < blocks.size(); ++b) {
      const std::size_t begin = b * LevelTriangles::kBlock, end = std::min(begin + LevelTriangles::kBlock, copy.size());
      if (blocks[b] > copied) std::copy(triangles.begin() + begin, triangles.begin() + end, copy.begin() + begin);
    }
    copied = levels.version();
    ASSERT_EQ(copy, triangles);
  }
}

TEST(LevelTriangles, StepTouchesFacesOfItsVerticesOnly) {
  const Asset& asset = baked_heart();
  LevelTriangles levels;
  std::vector<std::uint32_t> triangles;
  levels.update(asset, triangles);
  levels.set_level(asset.vertex_count / 2, triangles);
  const std::uint64_t before = levels.version();
  levels.set_level(asset.vertex_count / 2 + 3, triangles);
  const auto& blocks = levels.block_versions();
  const auto changed = std::count_if(blocks.begin(), blocks.end(), [&](std::uint64_t v) { return v > before; });
  EXPECT_GE(changed, 1);
  EXPECT_LE(changed, 3 * 8) << "of " << blocks.size() << ": three vertices of some six faces each";
}

TEST(LevelTriangles, FollowAnAssetThatArrives) {
  const auto bytes = encode_asset(baked_heart(), {.first_chunk_rows = 256});
  ASSERT_TRUE(bytes);
  auto reader = AssetReader::from_manifest(bytes->manifest.id, bytes->manifest.bytes);
  ASSERT_TRUE(reader);
  LevelTriangles levels;
  std::vector<std::uint32_t> triangles;
  EXPECT_FALSE(levels.update(reader->asset(), triangles)) << "nothing has come";
  for (std::size_t i = 0; i < bytes->chunks.size(); ++i) {
    ASSERT_TRUE(reader->add_chunk(i, bytes->chunks[i].bytes));
    const Asset& asset = reader->asset();
    EXPECT_TRUE(levels.update(asset, triangles));
    ASSERT_EQ(triangles, triangles_at_level(asset, levels.level())) << "the level stays while more comes";
    for (const std::uint32_t N : {asset.rows_ready, asset.base_count, (asset.base_count + asset.rows_ready) / 2}) {
      levels.set_level(N, triangles);
      ASSERT_EQ(triangles, triangles_at_level(asset, N));
    }
    EXPECT_FALSE(levels.update(asset, triangles));
  }
}

TEST(LevelMorphs, VerticesArriveInTime) {
  LevelMorph morph;
  morph.jump(10);
  EXPECT_FALSE(morph.advance(10, 0));
  EXPECT_TRUE(morph.advance(14, kFrame));
  EXPECT_EQ(morph.drawn(), 14u);
  EXPECT_EQ(morph.whole(), 10u);
  TimeUs now = kFrame;
  int frames = 1;
  double last = morph.effective();
  for (; morph.whole() < 14; ++frames) {
    ASSERT_TRUE(morph.advance(14, now += kFrame));
    EXPECT_GT(morph.effective(), last);
    EXPECT_LE(morph.effective() - last, 4 * static_cast<double>(kFrame) / MorphPace::kAppear + 1e-5);
    last = morph.effective();
  }
  EXPECT_NEAR(frames, static_cast<double>(MorphPace::kAppear) / kFrame, 2);
  EXPECT_FALSE(morph.advance(14, now += kFrame));
  for (frames = 0; morph.drawn() > 6; ++frames) {
    ASSERT_TRUE(morph.advance(6, now += kFrame));
    EXPECT_EQ(morph.whole(), 6u);
  }
  EXPECT_NEAR(frames, static_cast<double>(MorphPace::kVanish) / kFrame, 2);
  EXPECT_FALSE(morph.advance(6, now += kFrame));
}

TEST(LevelMorphs, DurationFollowsTheWayOnTheScreen) {
  const double unknown = std::numeric_limits<double>::infinity();
  for (const auto& [pixels, appear, vanish] :
       {std::tuple(unknown, 250'000, 100'000), std::tuple(100.0, 250'000, 100'000), std::tuple(6.0, 200'000, 100'000),
        std::tuple(1.5, 50'000, 50'000), std::tuple(0.0, 0, 0), std::tuple(std::nan(""), 250'000, 100'000)}) {
    const MorphPace pace = MorphPace::of(pixels);
    EXPECT_EQ(pace.appear_us, appear) << pixels;
    EXPECT_EQ(pace.vanish_us, vanish) << pixels;
  }
  for (const double pixels : {0.0, 0.4}) {
    LevelMorph morph;
    morph.jump(10);
    morph.advance(10, 0);
    morph.advance(14, kFrame, MorphPace::of(pixels));
    EXPECT_EQ(morph.whole(), 14u) << "less than half a pixel takes no time";
    morph.advance(6, 2 * kFrame, MorphPace::of(pixels));
    EXPECT_EQ(morph.drawn(), 6u);
  }
}

TEST(LevelMorphs, JumpAfterLongAbsenceOnly) {
  LevelMorph morph;
  morph.jump(10);
  morph.advance(10, 0);
  morph.advance(20, 400'000);
  EXPECT_LE(morph.effective(), 10 + 10.0 * LevelMorph::kMaxStep / MorphPace::kAppear + 1e-5);
  morph.advance(20, 400'000 + LevelMorph::kOutOfSight);
  EXPECT_EQ(morph.whole(), 20u);
}

TEST(LevelMorphs, ReversedMorphContinuesFromItsWeights) {
  // Up and down at random: weights are never larger further on, and nothing jumps (asserted in advance()).
  LevelMorph morph;
  morph.jump(100);
  std::mt19937 random(1);
  std::uniform_int_distribution<std::uint32_t> level(20, 200);
  TimeUs now = 0;
  morph.advance(100, now);
  for (int i = 0; i < 500; ++i) {
    const double before = morph.effective();
    const std::uint32_t whole = morph.whole(), drawn = morph.drawn();
    morph.advance(level(random), now += kFrame);
    const double moving = std::max(morph.drawn(), drawn) - std::min(morph.whole(), whole);
    ASSERT_LE(std::abs(morph.effective() - before), moving * kFrame / MorphPace::kVanish + 1e-3);
  }
}

TEST(LevelMorphs, PositionsFollowChainsOfMovingParents) {
  LevelMorph morph;
  morph.jump(2);
  morph.advance(2, 0);
  morph.advance(4, 25'000);  // both at a tenth of their way
  const std::vector<std::uint32_t> map{0, 1, 1, 2};
  std::vector<float> x{0, 0, 0, 1, 0, 0, 1, 1, 0, 1, 1, 1};
  morph.blend(map, x);
  const auto expect = [&](std::size_t i, float a, float b, float c) {
    EXPECT_NEAR(x[3 * i], a, 1e-6);
    EXPECT_NEAR(x[3 * i + 1], b, 1e-6);
    EXPECT_NEAR(x[3 * i + 2], c, 1e-6);
  };
  expect(1, 1, 0, 0);
  expect(2, 1, 0.1F, 0);
  expect(3, 1, 0.1F + 0.1F * 0.9F, 0.1F);
}

TEST(LevelMorphs, NewVerticesChangeNothingAtFirst) {
  const Asset& asset = baked_heart();
  const std::uint32_t N = asset.vertex_count / 5, more = asset.vertex_count / 2;
  Reconstructor reconstructor;
  reconstructor.update(asset);
  std::vector<float> coarse(3 * N), fine(3 * more), coarse_normals(3 * N), fine_normals(3 * more);
  reconstructor.rebuild(asset.rest, 3, asset.rank, N, coarse);
  reconstructor.rebuild(asset.rest, 3, asset.rank, more, fine);
  vertex_normals(coarse, triangles_at_level(asset, N), coarse_normals);
  LevelMorph morph;
  morph.jump(N);
  morph.advance(N, 0);
  morph.advance(more, 0);
  morph.blend(asset.map, fine);
  area_normals(fine, triangles_at_level(asset, more), fine_normals);
  morph.share(asset.map, fine_normals);
  normalise(fine_normals);
  for (std::uint32_t i = 0; i < more; ++i) {
    std::uint32_t at = i;
    while (at >= N) at = asset.map[at];
    for (std::size_t d = 0; d < 3; ++d) {
      ASSERT_NEAR(fine[3 * i + d], coarse[3 * at + d], 1e-6F) << i;
      ASSERT_NEAR(fine_normals[3 * i + d], coarse_normals[3 * at + d], 2e-4F) << i;
    }
  }
}

/// The heart in one pose.
struct PausedHeart {
  explicit PausedHeart(bool morph = true) : source(baked_heart()), view({.playout = {}, .morph = morph}) {
    view.receive(source, {testing::heart_pose(0.3, now)});
    testing::advance(view, source, now);
    view.set_paused(true);
  }
  bool turn(double fraction, TimeUs step = kFrame) {
    view.lod().set_fraction(fraction);
    return testing::advance(view, source, now += step);
  }
  TimeUs now = 1'000'000;
  testing::FakeSource source;
  SurfaceView view;
};

TEST(ProgressiveSurfaces, DownAndUpGivesTheSameBuffers) {
  PausedHeart still;
  const SurfaceGeometry full = still.view.geometry();
  ASSERT_EQ(full.vertex_count(), baked_heart().vertex_count);
  for (const double fraction : {0.5, 0.52, 0.1, 0.3, 0.05, 1.0}) {
    int frames = 0;
    while (still.turn(fraction)) ASSERT_LT(++frames, 40);
    EXPECT_GE(frames, 5);
    PausedHeart fresh(false);
    fresh.turn(fraction);
    const SurfaceGeometry &a = still.view.geometry(), &b = fresh.view.geometry();
    ASSERT_EQ(a.positions, b.positions) << fraction;
    ASSERT_EQ(a.normals, b.normals) << fraction;
    ASSERT_EQ(a.triangles, b.triangles) << fraction;
  }
  EXPECT_EQ(still.view.geometry().positions, full.positions);
  EXPECT_EQ(still.view.geometry().normals, full.normals);
}

TEST(ProgressiveSurfaces, StillPoseRebuildsOnlyNewRows) {
  PausedHeart still;
  while (still.turn(0.25)) {
  }
  const std::uint32_t before = still.view.geometry().vertex_count();
  still.view.lod().set_fraction(0.5);
  ASSERT_TRUE(still.view.prepare(still.source, still.now += kFrame));
  EXPECT_EQ(still.view.job(*still.source.asset()).first, before);
  EXPECT_EQ(still.view.job(*still.source.asset()).vertices(), baked_heart().vertex_count / 2);
}

/// What changes from one picture to the next while the level goes from one to another and nothing else does.
struct Smoothness {
  double max_mean = 0;    ///< Largest mean difference of two pictures in a row, of 255.
  int max_pixel = 0;      ///< Largest difference of a channel.
  double end_to_end = 0;  ///< Mean difference of the first and the last.
  int pictures = 0;
};

Smoothness go_over(Renderer& renderer, bool morph, double from, double to, bool size_known = false) {
  constexpr int kWidth = 240, kHeight = 180;
  PausedHeart still(morph);
  while (still.turn(from)) {
  }
  Camera camera;
  camera.set_viewport(kWidth, kHeight);
  camera.set_view("iso");
  const auto& f = still.view.facts();
  camera.set_scene(f.low, f.high);
  if (size_known) still.view.set_px_per_unit(camera.max_px_per_unit(camera.target(), camera.scene_radius()));
  const auto picture = [&] {
    renderer.upload(0, still.view.geometry());
    return renderer.picture(camera, {}, kWidth, kHeight).value();
  };
  Smoothness result;
  const Picture first = picture();
  Picture last = first;
  while (still.turn(to)) {
    Picture next = picture();
    result.max_mean = std::max(result.max_mean, testing::mean_difference(last, next, &result.max_pixel));
    last = std::move(next);
    ++result.pictures;
  }
  result.end_to_end = testing::mean_difference(first, last);
  return result;
}

using SurfacePictures = testing::OffscreenPictures;

TEST_F(SurfacePictures, LevelChangesStayBelowTheBound) {
  for (const auto& [from, to] : {std::pair(0.02, 1.0), std::pair(0.5, 0.05)}) {
    const Smoothness jump = go_over(*renderer_, false, from, to), smooth = go_over(*renderer_, true, from, to);
    ASSERT_EQ(jump.pictures, 1);
    EXPECT_NEAR(smooth.end_to_end, jump.end_to_end, 1e-9) << "the same at the end";
    EXPECT_LE(smooth.max_mean, 0.4) << "of 255, from picture to picture at 60/s, whatever the levels";
    EXPECT_LE(smooth.max_mean, 0.45 * jump.max_mean);
    EXPECT_LT(smooth.max_pixel, jump.max_pixel);
  }
  for (const auto& [from, to] :
       {std::pair(0.02, 1.0), std::pair(0.5, 0.05), std::pair(0.3, 1.0), std::pair(1.0, 0.5)}) {
    const Smoothness jump = go_over(*renderer_, false, from, to), quick = go_over(*renderer_, true, from, to, true);
    EXPECT_NEAR(quick.end_to_end, jump.end_to_end, 1e-9);
    EXPECT_LE(quick.max_mean, 0.4) << "where vertices take as long as their way on the screen needs";
    if (from >= 0.3 && to >= 0.3) {
      EXPECT_LE(quick.pictures, 10) << "short ways";
    }
  }
}

GLsizeiptr bytes_sent = 0;
PFNGLBUFFERDATAPROC send_all = nullptr;
PFNGLBUFFERSUBDATAPROC send_part = nullptr;

/// What OpenGL's buffers are sent. REQUIRES: they have been sent something before.
GLsizeiptr bytes_sent_by(Renderer& renderer, const SurfaceGeometry& geometry) {
  bytes_sent = 0;
  send_all = std::exchange(epoxy_glBufferData, [](GLenum target, GLsizeiptr size, const void* data, GLenum usage) {
    bytes_sent += data != nullptr ? size : 0;
    send_all(target, size, data, usage);
  });
  send_part = std::exchange(epoxy_glBufferSubData, [](GLenum target, GLintptr at, GLsizeiptr size, const void* data) {
    bytes_sent += size;
    send_part(target, at, size, data);
  });
  renderer.upload(0, geometry);
  epoxy_glBufferData = send_all;
  epoxy_glBufferSubData = send_part;
  return bytes_sent;
}

TEST_F(SurfacePictures, LevelChangesSendOnlyWhatChanges) {
  constexpr int kWidth = 160, kHeight = 120;
  PausedHeart still;
  frame(still.view.facts());
  for (const auto& [from, to, part] :
       {std::tuple(0.9, 0.92, 0.6), std::tuple(0.5, 1.0, 0.9), std::tuple(1.0, 0.9, 0.75)}) {
    while (still.turn(from)) renderer_->upload(0, still.view.geometry());
    renderer_->upload(0, still.view.geometry());
    double all = 0, sent = 0;
    while (still.turn(to)) {
      const SurfaceGeometry& geometry = still.view.geometry();
      sent += static_cast<double>(bytes_sent_by(*renderer_, geometry));
      all += 4.0 * static_cast<double>(geometry.positions.size() + geometry.normals.size());
    }
    EXPECT_LT(sent, part * all) << from << " to " << to << ": positions of what moves, normals about it";
    const Picture followed = renderer_->picture(camera_, {}, kWidth, kHeight).value();
    renderer_->set_surface_count(0);
    renderer_->set_surface_count(1);
    renderer_->upload(0, still.view.geometry());
    EXPECT_EQ(renderer_->picture(camera_, {}, kWidth, kHeight)->rgb, followed.rgb);
  }
}

}  // namespace
}  // namespace eigencast
