// SPDX-License-Identifier: MIT
#include "view/markup.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>

#include "view/camera.h"

namespace eigencast {
namespace {

constexpr int kMarkupWidth = 400, kMarkupHeight = 300;

struct MarkupScene {
  MarkupScene() {
    camera.set_viewport(kMarkupWidth, kMarkupHeight);
    camera.set_scene({-1, -1, -1}, {1, 1, 1});
  }
  MarkTriangles triangles(const Markup& markup) const {
    return triangles_from_markup(markup, camera.clip_from_view() * camera.view_from_scene(), kMarkupWidth,
                                 kMarkupHeight);
  }
  static glm::vec2 px(const MarkCorner& corner) {
    const glm::vec2 ndc = glm::vec2(corner.clip) / corner.clip.w;
    return {(0.5F + 0.5F * ndc.x) * kMarkupWidth, (0.5F - 0.5F * ndc.y) * kMarkupHeight};
  }
  Camera camera;
};

TEST(Markup, DotsAreSquaresOfTheirDiameter) {
  MarkupScene scene;
  Markup markup;
  markup.dots.push_back({{0.3F, 0.2F, -0.4F}, {1, 0, 0, 1}, 10, false});
  const MarkTriangles t = scene.triangles(markup);
  ASSERT_EQ(t.corners.size(), 6U);
  EXPECT_EQ(t.top, 6U);
  const glm::vec2 at = *scene.camera.pixel_from_scene({0.3F, 0.2F, -0.4F});
  for (const MarkCorner& corner : t.corners) {
    const glm::vec2 off = MarkupScene::px(corner) - at;
    EXPECT_NEAR(std::abs(off.x), 5, 0.01);
    EXPECT_NEAR(std::abs(off.y), 5, 0.01);
    EXPECT_NEAR(glm::length(corner.round), std::sqrt(2.0F), 1e-6);
  }
}

TEST(Markup, LineWidthDoesNotDependOnDistance) {
  MarkupScene scene;
  Markup markup;
  markup.lines.push_back({{-0.5F, -0.5F, 1}, {0.7F, 0.4F, -1}, {1, 1, 1, 1}, 4, false});
  const MarkTriangles t = scene.triangles(markup);
  ASSERT_EQ(t.corners.size(), 6U);
  EXPECT_NEAR(glm::length(MarkupScene::px(t.corners[0]) - MarkupScene::px(t.corners[5])), 4, 0.01);
  EXPECT_NEAR(glm::length(MarkupScene::px(t.corners[1]) - MarkupScene::px(t.corners[2])), 4, 0.01);
}

TEST(Markup, LinesAreClippedBeforeTheCamera) {
  MarkupScene scene;
  const glm::vec3 eye = scene.camera.position(), back = glm::normalize(eye - scene.camera.target());
  Markup markup;
  markup.lines.push_back({scene.camera.target(), eye + 3.0F * back + glm::vec3(0.5F, 0.2F, 0), {1, 1, 1, 1}, 2, false});
  markup.lines.push_back({eye + back, eye + 2.0F * back, {1, 1, 1, 1}, 2, false});
  markup.dots.push_back({eye + back, {1, 1, 1, 1}, 8, false});
  const MarkTriangles t = scene.triangles(markup);
  ASSERT_EQ(t.corners.size(), 6U) << "of the three only the first is before the camera";
  for (const MarkCorner& corner : t.corners) EXPECT_GT(corner.clip.w, 0);
}

TEST(Markup, MarksOnTopComeLast) {
  MarkupScene scene;
  Markup markup;
  markup.dots.push_back({{0, 0, 0}, {1, 1, 1, 1}, 8, true});
  markup.dots.push_back({{0, 0, 0}, {1, 1, 1, 1}, 8, false});
  markup.frame.emplace(glm::vec2(10, 20), glm::vec2(30, 50));
  const MarkTriangles t = scene.triangles(markup);
  EXPECT_EQ(t.top, 6U);
  EXPECT_EQ(t.corners.size(), 6U + 6U + 4 * 6U);
}

}  // namespace
}  // namespace eigencast
