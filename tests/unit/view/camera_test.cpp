// SPDX-License-Identifier: MIT
#include "view/camera.h"

#include <gtest/gtest.h>

#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <span>
#include <utility>
#include <vector>

namespace eigencast {
namespace {

Camera camera_of(int width = 800, int height = 600) {
  Camera camera;
  camera.set_viewport(width, height);
  camera.set_scene({-1, -2, -3}, {3, 2, 1});
  return camera;
}

/// Where the points lie in the window, whose sides are at -1 and 1.
std::pair<glm::vec2, glm::vec2> extent(const Camera& camera, std::span<const glm::vec3> points, int width, int height) {
  glm::vec2 low(1e9F), high(-1e9F);
  for (const glm::vec3& point : points) {
    const auto pixel = camera.pixel_from_scene(point);
    if (!pixel) return {glm::vec2(-1e9F), glm::vec2(1e9F)};
    const glm::vec2 at = 2.0F * *pixel / glm::vec2(width, height) - 1.0F;
    low = glm::min(low, at);
    high = glm::max(high, at);
  }
  return {low, high};
}

TEST(Camera, FramesPointsAtTwoThirdsInTheMiddle) {
  const std::vector<std::vector<glm::vec3>> shapes{
      {},                                                                                           // the box
      {{-1, -2, -3}, {3, -2, 1}, {2.5F, 2, 1}, {-1, 0, -3}},                                        // lop-sided
      {{-1, -2, 1}, {-0.9F, -2, 1}, {-1, -1.9F, 1}, {3, 2, -3}, {2.9F, 2, -3}, {3, 1.9F, -2.9F}}};  // a rod
  for (const auto& [width, height] : {std::pair{800, 600}, {300, 900}, {1600, 200}}) {
    for (const char* view : {"iso", "front", "back", "left", "right", "top", "bottom"}) {
      for (const Camera::Up up : {Camera::Up::kX, Camera::Up::kY, Camera::Up::kZ}) {
        for (const auto& shape : shapes) {
          Camera camera;
          camera.set_viewport(width, height);
          const Bounds box{{-1, -2, -3}, {3, 2, 1}};
          camera.set_scene(box.low, box.high, shape);
          camera.set_up(up);
          ASSERT_TRUE(camera.set_view(view));
          const auto corners = box.corners();
          const auto [low, high] =
              extent(camera, shape.empty() ? std::span<const glm::vec3>(corners) : shape, width, height);
          const glm::vec2 part = 0.5F * (high - low);
          EXPECT_NEAR(std::max(part.x, part.y), 2.0F / 3, 1e-3F) << view << ": of the window";
          EXPECT_NEAR(high.x, -low.x, 0.01F) << view << ": in the middle";
          EXPECT_NEAR(high.y, -low.y, 0.01F) << view << ": in the middle";
        }
      }
    }
  }
}

TEST(Camera, FrontLooksAlongTheAxisWithUpUp) {
  Camera camera = camera_of();
  camera.set_view("front");
  const glm::vec3 centre = camera.target();
  EXPECT_GT(camera.position().z, centre.z);
  EXPECT_NEAR(camera.position().x, centre.x, 1e-4);
  EXPECT_LT(camera.pixel_from_scene(centre + glm::vec3(0, 1, 0))->y, 300);
  EXPECT_GT(camera.pixel_from_scene(centre + glm::vec3(1, 0, 0))->x, 400);
}

TEST(Camera, RotatingKeepsTargetAndDistance) {
  Camera camera = camera_of();
  const float before = camera.distance();
  camera.rotate({120, -4000});
  EXPECT_NEAR(glm::length(camera.position() - camera.target()), before, 1e-3);
  EXPECT_LT(camera.position().y, camera.target().y);  // dragged up: seen from below, never turned over
  EXPECT_GT(camera.view_from_scene()[1][1], 0);
}

TEST(Camera, ZoomKeepsThePointUnderTheCursor) {
  Camera camera = camera_of();
  const glm::vec3 point = camera.target();
  camera.pan({150, -70});
  const glm::vec2 cursor = *camera.pixel_from_scene(point);
  const float before = camera.distance();
  camera.zoom(5, cursor);
  EXPECT_LT(camera.distance(), before);
  EXPECT_NEAR(camera.pixel_from_scene(point)->x, cursor.x, 0.5);
  EXPECT_NEAR(camera.pixel_from_scene(point)->y, cursor.y, 0.5);
}

TEST(Camera, PanMovesTheSceneWithTheCursor) {
  Camera camera = camera_of();
  const glm::vec3 point = camera.target();
  camera.pan({31, 17});
  EXPECT_NEAR(camera.pixel_from_scene(point)->x, 431, 0.5);
  EXPECT_NEAR(camera.pixel_from_scene(point)->y, 317, 0.5);
}

TEST(Camera, ZoomIsBounded) {
  Camera camera = camera_of();
  camera.zoom(1000, {400, 300});
  EXPECT_GT(camera.distance(), 0);
  camera.zoom(-5000, {400, 300});
  EXPECT_LE(camera.distance(), 61 * camera.scene_radius());
}

TEST(Camera, GrowingSceneLeavesMovedCamera) {
  Camera camera = camera_of();
  camera.set_scene({-10, -10, -10}, {10, 10, 10});
  const float framed = camera.distance();
  EXPECT_GT(framed, 20);
  camera.rotate({10, 0});
  camera.set_scene({-1, -1, -1}, {1, 1, 1});
  EXPECT_FLOAT_EQ(camera.distance(), framed);
  camera.home();
  EXPECT_LT(camera.distance(), framed);
}

TEST(Camera, UnknownViewsAndFlatScenesAreHandled) {
  Camera camera = camera_of();
  EXPECT_FALSE(camera.set_view("sideways"));
  camera.set_scene({1, 1, 1}, {1, 1, 1});
  EXPECT_TRUE(std::isfinite(camera.clip_from_view()[0][0]));
  EXPECT_GT(camera.distance(), 0);
}

TEST(Camera, DiameterIsThatOfTheSilhouette) {
  Camera camera;
  camera.set_viewport(400, 300);
  camera.look_from({0, 0, 10}, {0, 0, 0});
  const double focal = 150 / std::tan(0.5 * Camera::kFieldOfView);
  EXPECT_NEAR(camera.diameter_px({0, 0, 0}, 1), 2 * focal / std::sqrt(99), 0.1);
  EXPECT_EQ(camera.diameter_px({0, 0, 20}, 1), 0) << "behind";
  EXPECT_EQ(camera.diameter_px({9, 0, 0}, 1), 0) << "to the right of the picture";
  EXPECT_EQ(camera.diameter_px({0, -9, 0}, 1), 0);
  EXPECT_GT(camera.diameter_px({4.6F, 0, 0}, 1), 0) << "a part of it is in the picture";
  EXPECT_DOUBLE_EQ(camera.diameter_px({0, 0, 10}, 1), 500) << "around the eye: the whole picture";
  EXPECT_NEAR(camera.max_px_per_unit({0, 0, 0}, 1), focal / 9, 0.01);
  EXPECT_TRUE(std::isinf(camera.max_px_per_unit({0, 0, 9.5F}, 1)));
}

TEST(Camera, LookFromSetsEyeAndTarget) {
  for (const Camera::Up up : {Camera::Up::kX, Camera::Up::kY, Camera::Up::kZ}) {
    Camera camera;
    camera.set_up(up);
    for (const glm::vec3 eye : {glm::vec3(3, 1, 2), glm::vec3(-2, 4, -1), glm::vec3(0.5F, -3, 1)}) {
      camera.look_from(eye, {0.5F, 0.25F, -1});
      EXPECT_NEAR(glm::length(camera.position() - eye), 0, 1e-4);
      EXPECT_EQ(camera.target(), glm::vec3(0.5F, 0.25F, -1));
    }
  }
}

}  // namespace
}  // namespace eigencast
