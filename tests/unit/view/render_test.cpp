// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <glm/ext/matrix_transform.hpp>

#include "tests/unit/view/fake_source.h"
#include "tests/unit/view/offscreen_pictures.h"

namespace eigencast {
namespace {

using testing::FakeSource;
using testing::is_clay;
using testing::mean_difference;
using testing::OffscreenPictures;
using testing::sphere_asset;
using testing::sphere_pose;

constexpr int kWidth = 320, kHeight = 240;

/// Where the surface is in a picture: pixels that differ from the picture of the empty scene by more than the floor's
/// shadow.
struct Silhouette {
  double area = 0, x = 0, y = 0;
};

Silhouette silhouette_of(const Picture& picture) {
  Silhouette s;
  for (int y = 0; y < picture.height; ++y) {
    for (int x = 0; x < picture.width; ++x) {
      if (!is_clay(picture.pixel(x, y))) continue;
      s.area += 1;
      s.x += x + 0.5;
      s.y += y + 0.5;
    }
  }
  if (s.area > 0) {
    s.x /= s.area;
    s.y /= s.area;
  }
  return s;
}

class Render : public OffscreenPictures {
 protected:
  void SetUp() override {
    OffscreenPictures::SetUp();
    if (HasFatalFailure()) return;
    camera_.set_viewport(kWidth, kHeight);
    camera_.set_view("front");
  }

  Picture picture_of(FakeSource& source, SurfaceView& scene, TimeUs now_us = 0) {
    scene.receive(source, source.poll({}));
    if (testing::advance(scene, source, now_us)) renderer_->upload(0, scene.geometry());
    if (scene.facts().version > 0) frame(scene.facts());
    auto picture = renderer_->picture(camera_, options_, kWidth, kHeight);
    EXPECT_TRUE(picture);
    return std::move(picture).value();
  }

  RenderOptions options_;
};

TEST_F(Render, SphereHasItsSizeInThePicture) {
  FakeSource source(sphere_asset(4));
  SurfaceView scene;
  const Silhouette s = silhouette_of(picture_of(source, scene));
  // A ball of radius 1 seen from distance d has a silhouette of radius f / sqrt(d^2 - 1), f = focal length in pixels.
  const double focal = 0.5 * kHeight / std::tan(0.5 * Camera::kFieldOfView);
  const double radius = focal / std::sqrt(camera_.distance() * camera_.distance() - 1);
  EXPECT_NEAR(s.area, 3.14159 * radius * radius, 0.03 * s.area);
  EXPECT_NEAR(s.x, 0.5 * kWidth, 1.5);
  EXPECT_NEAR(s.y, 0.5 * kHeight, 1.5);
}

TEST_F(Render, AMovedPoseMovesInThePicture) {
  FakeSource source(sphere_asset(3));
  SurfaceView scene;
  picture_of(source, scene);
  source.batches.push_back({sphere_pose(source.asset_, 1, 1000, 0.6, 0.5)});
  const Silhouette s = silhouette_of(picture_of(source, scene, 1000));
  const auto centre = camera_.pixel_from_scene({0.5F, 0, 0});
  ASSERT_TRUE(centre);
  EXPECT_NEAR(s.x, centre->x, 3);
  EXPECT_NEAR(s.y, centre->y, 3);
}

TEST_F(Render, LevelsOfDetailLookAlike) {
  FakeSource source(sphere_asset(5));
  SurfaceView scene;
  const Picture full = picture_of(source, scene);
  scene.lod().set_fraction(0.25);
  const Picture quarter = picture_of(source, scene, 1'000'000);
  EXPECT_LT(scene.geometry().vertex_count(), source.asset_.vertex_count / 3);
  EXPECT_GT(mean_difference(full, quarter), 0);
  EXPECT_LT(mean_difference(full, quarter), 1.5);
}

TEST_F(Render, EdgesAreSmoothedByFourSamples) {
  FakeSource source(sphere_asset(4));
  SurfaceView scene;
  options_.grid = false;
  const Picture picture = picture_of(source, scene);
  EXPECT_EQ(renderer_->samples(), 4);
  // Walking down into the upper rim, red minus blue jumps from the wall's (negative) to the clay's (positive); with
  // four samples a pixel most columns have one pixel in between, without them none has.
  const auto warmth = [&](int x, int y) { return int{picture.pixel(x, y)[0]} - int{picture.pixel(x, y)[2]}; };
  int between = 0;
  for (int x = kWidth / 2 - 40; x < kWidth / 2 + 40; ++x) {
    int y = 2;
    while (warmth(x, y) < 0 && y < kHeight / 2) ++y;
    const int wall = warmth(x, y - 3), clay = warmth(x, y + 3);
    for (int at = y - 2; at <= y + 2; ++at) {
      if (warmth(x, at) > wall + (clay - wall) / 8 && warmth(x, at) < clay - (clay - wall) / 8) {
        ++between;
        break;
      }
    }
  }
  EXPECT_GT(between, 20);
}

TEST_F(Render, LowerQualityLooksAlike) {
  FakeSource source(sphere_asset(4));
  SurfaceView scene;
  const Picture full = picture_of(source, scene);
  const auto difference = [&](const PictureQuality& quality) {
    options_.quality = quality;
    return mean_difference(full, picture_of(source, scene));
  };
  double last = 0;
  for (const float scale : {0.9F, 0.7F, 0.5F}) {
    const double found = difference({.scale = scale});
    EXPECT_GT(found, 0);
    EXPECT_LT(found, 1) << scale;
    last = std::max(last, found);
  }
  EXPECT_GT(difference({.samples = 1}), 0);
  EXPECT_EQ(renderer_->samples(), 1);
  EXPECT_LT(difference({.samples = 1}), last) << "the rims alone";
  const auto mean_square = [&](const PictureQuality& quality) {
    options_.quality = quality;
    const Picture picture = picture_of(source, scene);
    double sum = 0;
    for (std::size_t i = 0; i < full.rgb.size(); ++i) sum += std::pow(int{full.rgb[i]} - int{picture.rgb[i]}, 2);
    return sum / static_cast<double>(full.rgb.size());
  };
  EXPECT_LT(mean_square({.scale = 1.1F, .samples = 1}), 0.8 * mean_square({.samples = 1})) << "more pixels mend rims";
  EXPECT_LT(mean_square({.scale = 1.414F, .samples = 1}), 0.7 * mean_square({.samples = 1}));
  const double small = difference({.shadow = ShadowQuality::kSmall});
  const double none = difference({.shadow = ShadowQuality::kNone});
  EXPECT_LT(small, 0.5 * none);
  EXPECT_GT(difference({.ground = false}), none) << "its shadow and its lines";
  EXPECT_EQ(difference({}), 0) << "and back";
}

TEST_F(Render, OnlyTheNewPoseIsSeen) {
  FakeSource source(sphere_asset(3));
  SurfaceView scene;
  picture_of(source, scene);
  for (const float scale : {1.0F, 0.5F, 1.3F}) {
    options_.quality.scale = scale;
    const auto moved_to = [&](float x) {
      renderer_->place(0, glm::translate(glm::mat4(1), glm::vec3(x, 0, 0)));
      return picture_of(source, scene);
    };
    const Picture there = moved_to(0.7F);
    moved_to(-0.7F);
    EXPECT_EQ(there.rgb, moved_to(0.7F).rgb) << scale;
    renderer_->place(0, glm::mat4(1), false);
    EXPECT_EQ(silhouette_of(picture_of(source, scene)).area, 0) << scale;
  }
}

TEST_F(Render, ASolidNeedsNoBackFaces) {
  FakeSource source(sphere_asset(4));
  SurfaceView scene;
  const Picture solid = picture_of(source, scene);
  ASSERT_TRUE(scene.geometry().is_solid);
  SurfaceGeometry open = scene.geometry();
  open.is_solid = false;
  renderer_->upload(0, open);
  const auto both_sides = renderer_->picture(camera_, options_, kWidth, kHeight);
  ASSERT_TRUE(both_sides);
  EXPECT_LT(mean_difference(solid, *both_sides), 1e-3);
  renderer_->place(0, glm::scale(glm::mat4(1), glm::vec3(-1, 1, 1)));
  EXPECT_NEAR(silhouette_of(picture_of(source, scene)).area, silhouette_of(solid).area, 20) << "mirrored";
}

TEST_F(Render, EmptySceneDraws) {
  FakeSource source(sphere_asset(2));
  source.has_asset = false;
  SurfaceView scene;
  const Picture picture = picture_of(source, scene);
  EXPECT_EQ(silhouette_of(picture).area, 0);
  EXPECT_GT(picture.pixel(kWidth / 2, kHeight / 2)[0], 100);
}

TEST_F(Render, ACloudIsAClosedBallOfSplats) {
  FakeSource source(sphere_asset(5, true));
  SurfaceView scene;
  const Silhouette s = silhouette_of(picture_of(source, scene));
  const double focal = 0.5 * kHeight / std::tan(0.5 * Camera::kFieldOfView);
  const double radius = focal / std::sqrt(camera_.distance() * camera_.distance() - 1);
  EXPECT_NEAR(s.area, 3.14159 * radius * radius, 0.12 * s.area);
}

TEST_F(Render, ALostConnectionTurnsItsSurfaceGrey) {
  FakeSource source(sphere_asset(3));
  SurfaceView scene;
  EXPECT_GT(silhouette_of(picture_of(source, scene)).area, 1000);
  renderer_->place(0, glm::mat4(1), true, 0);
  EXPECT_EQ(silhouette_of(picture_of(source, scene)).area, 0);
}

TEST_F(Render, EveryModeDraws) {
  FakeSource source(sphere_asset(3));
  SurfaceView scene;
  const Picture plain = picture_of(source, scene);
  for (bool RenderOptions::*mode :
       {&RenderOptions::edges, &RenderOptions::wireframe, &RenderOptions::points, &RenderOptions::axes}) {
    options_ = RenderOptions{};
    options_.*mode = true;
    EXPECT_GT(mean_difference(plain, picture_of(source, scene)), 0.05);
  }
}

/// The pixel where a point of the scene is.
const std::uint8_t* pixel_at(const Picture& picture, const Camera& camera, const glm::vec3& point) {
  const glm::vec2 at = camera.pixel_from_scene(point).value();
  return picture.pixel(static_cast<int>(at.x), static_cast<int>(at.y));
}

TEST_F(Render, LineWidthFollowsTheDisplay) {
  FakeSource source(sphere_asset(2));
  SurfaceView scene;
  options_.grid = false;
  const Picture plain = picture_of(source, scene);
  const auto changed = [&](RenderOptions options, float scale) {
    options.pixel_scale = scale;
    return mean_difference(plain, renderer_->picture(camera_, options, kWidth, kHeight).value());
  };
  RenderOptions edges, axes, points;
  edges.edges = axes.axes = points.points = true;
  edges.grid = axes.grid = points.grid = false;
  EXPECT_GT(changed(edges, 2), 1.4 * changed(edges, 1));
  EXPECT_GT(changed(axes, 3), changed(axes, 1));
  const auto drawn_as = [&](float scale) {
    points.pixel_scale = scale;
    return silhouette_of(renderer_->picture(camera_, points, kWidth, kHeight).value()).area;
  };
  EXPECT_GT(drawn_as(20), 1.5 * drawn_as(1)) << "points are 1.5 pixels across at least, of 96 dpi";
}

TEST_F(Render, NumbersHaveTheColoursOfTheirMap) {
  FakeSource source(sphere_asset(4));
  SurfaceView scene;
  picture_of(source, scene);
  SurfacePaint paint;
  paint.kind = SurfacePaint::Kind::kScalar;
  for (std::uint32_t i = 0; i < scene.geometry().vertex_count(); ++i)
    paint.values.push_back(scene.geometry().positions[3 * i]);  // x, from -1 to 1
  paint.version = 1;
  renderer_->paint(0, paint);
  options_.colour_range = {-1, 1};
  for (const ColourMap map : {ColourMap::kViridis, ColourMap::kCoolwarm, ColourMap::kGrey}) {
    options_.colour_map = map;
    const Picture picture = picture_of(source, scene);
    for (const float x : {-0.6F, 0.0F, 0.6F}) {
      const std::uint8_t* seen = pixel_at(picture, camera_, {x, 0, std::sqrt(1 - x * x)});
      const auto meant = table_of(map)[static_cast<std::size_t>(127.5F * (x + 1))];
      // The light changes how bright it is, not its hue: each channel by nearly the same factor.
      const double bright = (seen[0] + seen[1] + seen[2]) / static_cast<double>(meant[0] + meant[1] + meant[2]);
      EXPECT_GT(bright, 0.7);
      EXPECT_LT(bright, 1.15);
      for (std::size_t c = 0; c < 3; ++c)
        EXPECT_NEAR(seen[c], bright * meant[c], 10) << kColourMapNames[map] << " " << x;
    }
  }
}

TEST_F(Render, NormalsAndOwnColoursAreSeen) {
  FakeSource source(sphere_asset(4));
  SurfaceView scene;
  picture_of(source, scene);
  SurfacePaint paint;
  paint.kind = SurfacePaint::Kind::kNormal;
  paint.version = 1;
  renderer_->paint(0, paint);
  const Picture normals = picture_of(source, scene);
  const std::uint8_t* front = pixel_at(normals, camera_, {0, 0, 1});
  EXPECT_NEAR(front[0], 128, 4);
  EXPECT_NEAR(front[1], 128, 4);
  EXPECT_NEAR(front[2], 255, 4);
  paint.kind = SurfacePaint::Kind::kColour;
  for (std::uint32_t i = 0; i < scene.geometry().vertex_count(); ++i)
    paint.values.insert(paint.values.end(), {0.02F, 0.6F, 0.02F});
  paint.version = 2;
  renderer_->paint(0, paint);
  const Picture own = picture_of(source, scene);
  const std::uint8_t* green = pixel_at(own, camera_, {0, 0, 1});
  EXPECT_GT(green[1], 2 * green[0]);
}

TEST_F(Render, TransparentPicturesHaveAlpha) {
  FakeSource source(sphere_asset(4));
  SurfaceView scene;
  const Picture opaque = picture_of(source, scene);
  EXPECT_TRUE(opaque.alpha.empty());
  options_.transparent = true;
  const Picture picture = picture_of(source, scene);
  ASSERT_EQ(picture.alpha.size(), std::size_t{kWidth} * kHeight);
  const auto index = [&](int x, int y) { return static_cast<std::size_t>(y * kWidth + x); };
  EXPECT_EQ(picture.alpha[index(kWidth / 2, kHeight / 2)], 255);
  EXPECT_EQ(picture.alpha[index(2, 2)], 0);
  for (int c = 0; c < 3; ++c)
    EXPECT_NEAR(picture.pixel(kWidth / 2, kHeight / 2)[c], opaque.pixel(kWidth / 2, kHeight / 2)[c], 1);
  int partly = 0;
  for (const std::uint8_t a : picture.alpha) partly += a > 0 && a < 255 ? 1 : 0;
  EXPECT_GT(partly, 100) << "edges and the shadow";
  options_.grid = false;
  EXPECT_EQ(picture_of(source, scene).alpha, picture.alpha) << "the grid is not a part of what is cut out";
}

// Once all that lay outside the box of the floor's shadow was cut off: of the first picture, while later ones kept what
// had been there.
TEST_F(Render, TransparentPicturesAreWhole) {
  FakeSource source(sphere_asset(4));
  SurfaceView scene;
  camera_.set_view("iso");
  options_.transparent = true;
  const Picture first = picture_of(source, scene);
  options_.transparent = false;
  const Picture opaque = picture_of(source, scene);
  int cut_off = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x)
      cut_off += is_clay(opaque.pixel(x, y)) && first.alpha[static_cast<std::size_t>(y * kWidth + x)] == 0 ? 1 : 0;
  }
  EXPECT_EQ(cut_off, 0);
}

TEST_F(Render, WireframeHidesTheBack) {
  FakeSource source(sphere_asset(2));
  SurfaceView scene;
  const double full = silhouette_of(picture_of(source, scene)).area;
  options_.wireframe = true;
  const double lines = silhouette_of(picture_of(source, scene)).area;
  EXPECT_GT(lines, 0.02 * full);
  EXPECT_LT(lines, 0.7 * full);
}

TEST_F(Render, AnImpossibleSizeIsRefused) {
  EXPECT_FALSE(renderer_->picture(camera_, options_, 1 << 20, 10));
}

}  // namespace
}  // namespace eigencast
