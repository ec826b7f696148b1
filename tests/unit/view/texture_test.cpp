// SPDX-License-Identifier: MIT
// Surfaces drawn with an image: the UV of a corner at each level, what is decoded, what is seen.
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <fstream>
#include <iterator>
#include <thread>

#include "common/core/memory_budget.h"
#include "tests/support/process.h"
#include "tests/unit/view/fake_source.h"
#include "tests/unit/view/offscreen_pictures.h"
#include "view/paint.h"
#include "view/picture.h"
#include "view/texture_image.h"
#include "view/texture_levels.h"

namespace eigencast {
namespace {

using testing::FakeSource;
using testing::OffscreenPictures;
using testing::sphere_asset;
using testing::sphere_pose;

constexpr SurfacePainter::Wish kTextured{Colouring::kTextured, 3};

/// 8 x 4 pixels of one red, (192, 16, 32).
const Bytes kRedJpeg{
    0xff, 0xd8, 0xff, 0xe0, 0x00, 0x10, 0x4a, 0x46, 0x49, 0x46, 0x00, 0x01, 0x01, 0x00, 0x00, 0x01, 0x00, 0x01,
    0x00, 0x00, 0xff, 0xdb, 0x00, 0x43, 0x00, 0x06, 0x04, 0x05, 0x06, 0x05, 0x04, 0x06, 0x06, 0x05, 0x06, 0x07,
    0x07, 0x06, 0x08, 0x0a, 0x10, 0x0a, 0x0a, 0x09, 0x09, 0x0a, 0x14, 0x0e, 0x0f, 0x0c, 0x10, 0x17, 0x14, 0x18,
    0x18, 0x17, 0x14, 0x16, 0x16, 0x1a, 0x1d, 0x25, 0x1f, 0x1a, 0x1b, 0x23, 0x1c, 0x16, 0x16, 0x20, 0x2c, 0x20,
    0x23, 0x26, 0x27, 0x29, 0x2a, 0x29, 0x19, 0x1f, 0x2d, 0x30, 0x2d, 0x28, 0x30, 0x25, 0x28, 0x29, 0x28, 0xff,
    0xdb, 0x00, 0x43, 0x01, 0x07, 0x07, 0x07, 0x0a, 0x08, 0x0a, 0x13, 0x0a, 0x0a, 0x13, 0x28, 0x1a, 0x16, 0x1a,
    0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28,
    0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28,
    0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0x28, 0xff, 0xc0, 0x00, 0x11,
    0x08, 0x00, 0x04, 0x00, 0x08, 0x03, 0x01, 0x22, 0x00, 0x02, 0x11, 0x01, 0x03, 0x11, 0x01, 0xff, 0xc4, 0x00,
    0x15, 0x00, 0x01, 0x01, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
    0x00, 0x07, 0xff, 0xc4, 0x00, 0x14, 0x10, 0x01, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0xff, 0xc4, 0x00, 0x15, 0x01, 0x01, 0x01, 0x00, 0x00, 0x00, 0x00, 0x00,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x05, 0x07, 0xff, 0xc4, 0x00, 0x14, 0x11, 0x01, 0x00,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0xff, 0xda, 0x00,
    0x0c, 0x03, 0x01, 0x00, 0x02, 0x11, 0x03, 0x11, 0x00, 0x3f, 0x00, 0x99, 0x00, 0x19, 0x63, 0x7f, 0xff, 0xd9};

Bytes png_of(const Picture& picture) {
  const testing::TemporaryFolder folder;
  EXPECT_TRUE(write_png(folder.file("t.png"), picture));
  std::ifstream in(folder.file("t.png"), std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

/// Red for u below a half, blue above.
Bytes red_and_blue() {
  Picture picture{64, 64, {}};
  for (int i = 0; i < 64 * 64; ++i) {
    const bool red = i % 64 < 32;
    picture.rgb.insert(picture.rgb.end(),
                       {static_cast<std::uint8_t>(red ? 230 : 10), 10, static_cast<std::uint8_t>(red ? 10 : 230)});
  }
  return png_of(picture);
}

/// The sphere in two halves, of z below and above 0: two wedges at vertices of faces of both, at u = 0.25 and u = 0.75.
Asset textured_sphere(int subdivisions, Bytes image) {
  Asset asset = sphere_asset(subdivisions);
  AssetTexture t;
  // Both wedges at every vertex: any sides may meet there at some level.
  for (std::uint32_t i = 0; i <= asset.vertex_count; ++i) t.first_wedge.push_back(2 * i);
  for (std::uint32_t i = 0; i < asset.vertex_count; ++i) {
    for (std::uint32_t side = 0; side < 2; ++side) {
      t.uvs.push_back({static_cast<std::uint16_t>(side == 0 ? 16384 : 49150), static_cast<std::uint16_t>(7 * i)});
      t.parent.push_back(2 * asset.map[i] + side);
    }
  }
  for (const auto& face : asset.faces) {
    float z = 0;
    for (const std::uint32_t v : face) z += asset.entry(v, 3);
    const std::uint32_t side = z < 0 ? 0 : 1;
    t.corners.push_back({2 * face[0] + side, 2 * face[1] + side, 2 * face[2] + side});
  }
  t.image = std::move(image);
  asset.texture = std::make_shared<const AssetTexture>(std::move(t));
  EXPECT_TRUE(validate_asset(asset));
  return asset;
}

void show_at(FakeSource& source, SurfaceView& view, TimeUs now) {
  source.batches.push_back({sphere_pose(source.asset_, static_cast<std::uint64_t>(now), now, 1)});
  view.receive(source, source.poll({}));
  testing::advance(view, source, now);
}

TEST(TextureLevels, CornersKeepTheirSideOfTheSeam) {
  FakeSource source(textured_sphere(3, red_and_blue()));
  SurfaceView view;
  TextureLevels levels;
  show_at(source, view, 1000);
  TimeUs now = 10'000'000;
  for (const double fraction : {1.0, 0.3, 0.31, 0.05, 0.8, 1.0, 0.02}) {
    view.lod().set_fraction(fraction);
    for (int picture = 0; picture < 20; ++picture) {
      testing::advance(view, source, now += 20'000);
      levels.follow(source.asset_.texture, view.geometry(), view.morph());
      const auto& triangles = view.geometry().triangles;
      ASSERT_EQ(levels.corners().values.size(), triangles.size());
      ASSERT_EQ(levels.uvs().values.size(), 2u * view.geometry().vertex_count());
      for (std::size_t slot = 0; slot < triangles.size(); ++slot) {
        const std::uint32_t wedge = levels.corners().values[slot];
        ASSERT_EQ(wedge / 2, triangles[slot]) << "slot " << slot << " at " << fraction;
        ASSERT_EQ(wedge % 2, source.asset_.texture->corners[slot / 3][slot % 3] % 2);
        ASSERT_NEAR(levels.uvs().values[wedge][0], wedge % 2 == 0 ? 0.25 : 0.75, 1e-4);
      }
    }
  }
}

TEST(TextureLevels, UvsMorphAsVerticesDo) {
  FakeSource source(textured_sphere(2, red_and_blue()));
  SurfaceView view;
  TextureLevels levels;
  view.lod().set_fraction(42.0 / 162);
  show_at(source, view, 1000);
  levels.follow(source.asset_.texture, view.geometry(), view.morph());
  view.lod().set_fraction(1);
  testing::advance(view, source, 20'000);
  levels.follow(source.asset_.texture, view.geometry(), view.morph());
  const AssetTexture& t = *source.asset_.texture;
  const float weight = view.morph().weight(161);
  ASSERT_GT(weight, 0);
  ASSERT_LT(weight, 0.5F);
  const std::array<float, 2> from = levels.uvs().values[t.parent[322]], own = t.uv(322);
  EXPECT_NEAR(levels.uvs().values[322][1], from[1] + weight * (own[1] - from[1]), 1e-6);
  for (TimeUs now = 40'000; now < 900'000; now += 20'000) {
    testing::advance(view, source, now);
    levels.follow(source.asset_.texture, view.geometry(), view.morph());
  }
  for (std::uint32_t w = 0; w < t.uvs.size(); ++w) ASSERT_EQ(levels.uvs().values[w], t.uv(w)) << w;
}

TEST(TextureLevels, OnlyChangedBlocksAreMarked) {
  FakeSource source(textured_sphere(4, red_and_blue()));
  SceneOptions at_once;
  at_once.morph = false;
  SurfaceView view(at_once);
  TextureLevels levels;
  show_at(source, view, 1000);
  levels.follow(source.asset_.texture, view.geometry(), view.morph());
  const std::uint64_t before = levels.version();
  ASSERT_GT(levels.uvs().versions.size(), 4u);
  view.lod().set_fraction(2560.0 / 2562);
  testing::advance(view, source, 2000);
  levels.follow(source.asset_.texture, view.geometry(), view.morph());
  const auto fresh = [&](const auto& blocks) {
    return std::count_if(blocks.versions.begin(), blocks.versions.end(), [&](auto v) { return v > before; });
  };
  EXPECT_EQ(fresh(levels.uvs()), 0);
  EXPECT_LE(fresh(levels.corners()), 6) << "two vertices have about twelve faces";
}

TEST(Images, PngAndJpegAreDecodedOthersRefused) {
  const auto texture = [](Bytes image) {
    AssetTexture t;
    t.image = std::move(image);
    return std::make_shared<const AssetTexture>(std::move(t));
  };
  const auto jpeg = texture(kRedJpeg);
  const auto red = image_of(jpeg, Decode::kNow).picture;
  ASSERT_TRUE(red);
  EXPECT_EQ(red->width, 8);
  EXPECT_EQ(red->height, 4);
  EXPECT_NEAR(red->pixel(3, 2)[0], 192, 4);
  EXPECT_NEAR(red->pixel(3, 2)[2], 32, 4);
  EXPECT_EQ(image_of(jpeg, Decode::kNow).picture, red) << "decoded once";
  EXPECT_TRUE(image_of(texture(red_and_blue()), Decode::kNow).picture);
  for (std::size_t size = 0; size < 160; ++size) {
    const auto cut = read_jpeg_bytes(std::span(kRedJpeg).first(size), "cut");
    ASSERT_FALSE(cut) << size;
    EXPECT_FALSE(cut.error().message.empty());
  }
  for (std::size_t i = 2; i < kRedJpeg.size(); ++i) {
    for (const std::uint8_t value : {0x00, 0x7f, 0xff}) {
      Bytes bad = kRedJpeg;
      bad[i] = value;
      (void)read_jpeg_bytes(bad, "changed");  // whatever comes of it
    }
  }
  const auto other = image_of(texture({'B', 'M', 1, 2, 3}), Decode::kNow).failed;
  ASSERT_TRUE(other);
  EXPECT_EQ(other->code, ErrorCode::kUnsupported);
  EXPECT_TRUE(image_of(texture({0x89, 'P', 'N', 'G', 13, 10, 26, 10, 0}), Decode::kNow).failed);
  // A header of 16,383 x 16,383 pixels without them: refused before memory is asked for.
  Bytes huge = kRedJpeg;
  std::size_t header = 2;
  while (huge[header] != 0xff || huge[header + 1] != 0xc0) ASSERT_LT(++header, huge.size() - 9);
  huge[header + 5] = huge[header + 7] = 0x3f;
  huge[header + 6] = huge[header + 8] = 0xff;
  EXPECT_EQ(read_jpeg_bytes(huge, "huge").error().code, ErrorCode::kTooLarge);
}

TEST(Images, TakeNoMoreThanTheBudget) {
  const auto textured = [] {
    AssetTexture t;
    t.image = red_and_blue();
    return std::make_shared<const AssetTexture>(std::move(t));
  };
  const auto first = textured(), second = textured(), third = textured();
  const std::uint64_t before = received_memory().remaining();
  auto picture = image_of(first, Decode::kNow).picture;
  ASSERT_TRUE(picture);
  const std::uint64_t taken = before - received_memory().remaining();
  EXPECT_GE(taken, picture->rgb.size());
  picture.reset();
  EXPECT_EQ(received_memory().remaining(), before);
  received_memory().set_limit(taken / 2);
  const auto refused = image_of(second, Decode::kNow).failed;
  ASSERT_TRUE(refused);
  EXPECT_EQ(refused->code, ErrorCode::kTooLarge);
  received_memory().set_limit(before);
  EXPECT_TRUE(image_of(third, Decode::kNow).picture);
}

TEST(Images, AreHalvedUntilTheGpuTakesThem) {
  std::vector<std::shared_ptr<const AssetTexture>> textures;
  for (std::size_t i = 0; i < 2 * kMaxImagesWaiting; ++i) {
    AssetTexture t;
    t.image = red_and_blue();
    textures.push_back(std::make_shared<const AssetTexture>(std::move(t)));
  }
  std::vector<std::shared_ptr<const Picture>> pictures(textures.size());
  const auto ask = [&](std::size_t i) { return image_of(textures[i], Decode::kBackground, 20).picture; };
  for (int turn = 0; turn < 2000; ++turn) {
    bool all = true;
    for (std::size_t i = 0; i < textures.size(); ++i) {
      if (!pictures[i]) pictures[i] = ask(i);
      all = all && pictures[i];
    }
    if (all) break;
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  for (std::size_t i = 0; i < textures.size(); ++i) {
    ASSERT_TRUE(pictures[i]) << i << " of more than may wait";
    EXPECT_EQ(pictures[i]->width, 16);
    EXPECT_EQ(pictures[i]->pixel(3, 9)[0], 230);
    EXPECT_EQ(pictures[i]->pixel(12, 9)[2], 230);
    EXPECT_EQ(ask(i), pictures[i]);
  }
  AssetTexture broken;
  broken.image = {0xff, 0xd8, 0xff, 0, 1, 2};
  const auto bad = std::make_shared<const AssetTexture>(std::move(broken));
  TextureImage image;
  for (int turn = 0; turn < 2000 && !image.failed; ++turn) {
    image = image_of(bad, Decode::kBackground);
    if (!image.failed) std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  EXPECT_TRUE(image.failed);
  const Picture half = halved({2, 2, {0, 255, 10, 0, 255, 10, 255, 255, 10, 255, 255, 10}, {}});
  EXPECT_EQ(half.rgb, (std::vector<std::uint8_t>{180, 255, 10})) << "half the light, not half the number";
}

TEST(TexturePaint, SurfaceIsClayUntilItsImageIsDecoded) {
  FakeSource source(textured_sphere(2, red_and_blue()));
  SurfaceView view;
  show_at(source, view, 1000);
  SurfacePainter painter;
  painter.set_images(Decode::kBackground, kMaxTextureSide);
  painter.paint(view, source, kTextured);
  EXPECT_TRUE(painter.is_waiting());
  EXPECT_EQ(painter.paint().kind, SurfacePaint::Kind::kClay);
  for (int turn = 0; turn < 2000 && painter.is_waiting(); ++turn) {
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
    painter.paint(view, source, kTextured);
  }
  EXPECT_EQ(painter.paint().kind, SurfacePaint::Kind::kTexture) << painter.why_not();
}

TEST(TexturePaint, AutoTakesTheTextureElseTheColours) {
  const auto kind_of = [](Asset asset) {
    FakeSource source(std::move(asset));
    SurfaceView view;
    show_at(source, view, 1000);
    SurfacePainter painter;
    painter.paint(view, source, {});
    EXPECT_EQ(painter.why_not(), "");
    return painter.paint().kind;
  };
  Asset asset = textured_sphere(2, red_and_blue());
  EXPECT_EQ(kind_of(asset), SurfacePaint::Kind::kTexture);
  asset.texture.reset();
  asset.colours.assign(asset.vertex_count, {9, 8, 7});
  EXPECT_EQ(kind_of(asset), SurfacePaint::Kind::kColour);
  asset.colours.clear();
  EXPECT_EQ(kind_of(asset), SurfacePaint::Kind::kClay);
}

TEST(TexturePaint, AutoTakesATextureThatComesLater) {
  FakeSource source(textured_sphere(3, red_and_blue()));
  const auto texture = std::exchange(source.asset_.texture, nullptr);
  source.asset_.rows_ready = 162;
  SurfaceView view;
  show_at(source, view, 1000);
  SurfacePainter painter;
  painter.paint(view, source, {});
  EXPECT_EQ(painter.paint().kind, SurfacePaint::Kind::kClay);
  source.asset_.rows_ready = source.asset_.vertex_count;
  source.asset_.texture = texture;
  testing::advance(view, source, 2000);
  painter.paint(view, source, {});
  EXPECT_EQ(painter.paint().kind, SurfacePaint::Kind::kTexture);
}

TEST(TexturePaint, BrokenImageLeavesClay) {
  FakeSource source(textured_sphere(2, {0xff, 0xd8, 0xff, 0, 1, 2}));
  SurfaceView view;
  show_at(source, view, 1000);
  SurfacePainter painter;
  painter.paint(view, source, kTextured);
  EXPECT_EQ(painter.paint().kind, SurfacePaint::Kind::kClay);
  EXPECT_FALSE(painter.why_not().empty());
  FakeSource plain(sphere_asset(2));
  SurfaceView other;
  show_at(plain, other, 1000);
  painter.paint(other, plain, kTextured);
  EXPECT_FALSE(painter.why_not().empty());
}

class TexturedPictures : public OffscreenPictures {};

TEST_F(TexturedPictures, BothSidesOfTheSeamKeepTheirColour) {
  for (const double fraction : {1.0, 0.2, 0.05}) {
    FakeSource source(textured_sphere(4, red_and_blue()));
    SceneOptions options;
    options.lod = fraction;
    SurfaceView view(options);
    show_at(source, view, 1000);
    SurfacePainter painter;
    painter.paint(view, source, kTextured);
    ASSERT_EQ(painter.paint().kind, SurfacePaint::Kind::kTexture) << painter.why_not();
    ASSERT_EQ(painter.paint().values.size(), 3u * view.geometry().vertex_count());
    EXPECT_NEAR(painter.paint().values[0], std::pow(230 / 255.0, 2.2), 0.02)
        << "points are red where their first wedge is";
    frame(view.facts());
    camera_.set_view("right");
    renderer_->upload(0, view.geometry());
    renderer_->paint(0, painter.paint());
    const auto picture = renderer_->picture(camera_, {}, 160, 160);
    ASSERT_TRUE(picture) << picture.error().message;
    int red = 0, blue = 0, mixed = 0;
    for (int y = 60; y < 100; ++y) {
      for (int x = 50; x < 110; ++x) {
        const std::uint8_t* p = picture->pixel(x, y);
        red += p[0] > p[2] + 60 ? 1 : 0;
        blue += p[2] > p[0] + 60 ? 1 : 0;
        mixed += std::abs(p[0] - p[2]) <= 60 ? 1 : 0;
      }
    }
    EXPECT_GT(red, 700) << fraction;
    EXPECT_GT(blue, 700) << fraction;
    EXPECT_LT(mixed, 150) << fraction << ": the seam is sharp";
  }
}

}  // namespace
}  // namespace eigencast
