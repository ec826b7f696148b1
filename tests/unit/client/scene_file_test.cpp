// SPDX-License-Identifier: MIT
#include "client/scene_file.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <glm/geometric.hpp>

namespace eigencast {
namespace {

TEST(SceneFiles, SurfacesNameStreamsAndTransforms) {
  const auto scene = scene_from_json(R"({"surfaces": [
    {"stream": "ws://h/a", "name": "left"},
    {"stream": "ws://h/b", "position": [1, 2, 3], "scale": 2, "rotation_deg": [0, 0, 1, 90]},
    {"stream": "ws://h/a", "position": [5, 0, 0]},
    {"file": "heart"}]})");
  ASSERT_TRUE(scene) << scene.error().message;
  EXPECT_EQ(scene->streams, (std::vector<std::string>{"ws://h/a", "ws://h/b", "file:heart"}));
  ASSERT_EQ(scene->placements.size(), 4u);
  EXPECT_EQ(scene->placements[2].source, 0u);
  EXPECT_EQ(scene->placements[0].name, "left");
  EXPECT_FALSE(scene->row);
  const glm::vec4 moved = scene->placements[1].scene_from_world * glm::vec4(1, 0, 0, 1);
  EXPECT_NEAR(glm::length(glm::vec3(moved) - glm::vec3(1, 4, 3)), 0, 1e-5) << "scaled, turned, then moved";
}

TEST(SceneFiles, ErrorsNameTheField) {
  const std::vector<std::pair<const char*, const char*>> wrong{
      {"", "scene"},
      {"[]", "scene"},
      {R"({"surfaces": []})", "scene"},
      {R"({"surfaces": [7]})", "surfaces[0]"},
      {R"({"surfaces": [{"name": "x"}]})", "surfaces[0]"},
      {R"({"surfaces": [{"stream": "ws://h/a", "file": "heart"}]})", "surfaces[0]"},
      {R"({"surfaces": [{"file": 7}]})", "surfaces[0]"},
      {R"({"surfaces": [{"stream": "ws://h/a", "positon": [0, 0, 0]}]})", "surfaces[0]"},
      {R"({"surfaces": [{"stream": "ws://h/a", "position": [0, 0]}]})", "surfaces[0].position"},
      {R"({"surfaces": [{"stream": "ws://h/a", "position": [0, 0, 1e39]}]})", "surfaces[0].position"},
      {R"({"surfaces": [{"stream": "ws://h/a", "scale": 0}]})", "surfaces[0].scale"},
      {R"({"surfaces": [{"stream": "ws://h/a", "rotation_deg": [0, 0, 0, 9]}]})", "surfaces[0].rotation_deg"},
      {R"({"surfaces": [{"stream": "ws://h/a", "name": 7}]})", "surfaces[0].name"}};
  for (const auto& [text, path] : wrong) {
    const auto scene = scene_from_json(text);
    ASSERT_FALSE(scene) << text;
    EXPECT_EQ(scene.error().code, ErrorCode::kCorrupt);
    EXPECT_EQ(scene.error().message.find(std::string(path) + ": "), 0u) << scene.error().message;
  }
  std::string many = R"({"surfaces": [)";
  for (std::size_t i = 0; i <= kMaxSurfaces; ++i) many += R"({"stream": "ws://h/a"},)";
  many.back() = ']';
  EXPECT_EQ(scene_from_json(many + "}").error().code, ErrorCode::kTooLarge);
  EXPECT_EQ(read_scene_file("/nonexistent/scene.json").error().code, ErrorCode::kNotFound);
}

TEST(CameraPaths, PassesThroughItsKeysEvenly) {
  const auto path = CameraPath::from_json(R"({"keys": [
    {"t": 0, "eye": [0, 0, 5], "target": [0, 0, 0]},
    {"t": 1, "eye": [2, 0, 5], "target": [0, 0, 0]},
    {"t": 3, "eye": [6, 0, 5], "target": [0, 1, 0]}]})");
  ASSERT_TRUE(path) << path.error().message;
  EXPECT_EQ(path->seconds(), 3);
  for (const double t : {-1.0, 0.0, 0.25, 1.0, 1.7, 3.0, 9.0})
    EXPECT_NEAR(path->at(t).eye.x, 2 * std::clamp(t, 0.0, 3.0), 1e-5) << "keys of even motion give even motion";
  EXPECT_NEAR(path->at(3).target.y, 1, 1e-6);
  Camera camera;
  path->apply(1, camera);
  EXPECT_NEAR(glm::length(camera.position() - glm::vec3(2, 0, 5)), 0, 1e-5);
}

TEST(CameraPaths, ErrorsNameTheField) {
  for (const char* text : {"", "{}", R"({"keys": []})", R"({"keys": [{"t": 0}]})",
                           R"({"keys": [{"t": -1, "eye": [0, 0, 5], "target": [0, 0, 0]}]})",
                           R"({"keys": [{"t": 0, "eye": [0, 0, 5], "target": [0, 0, 5]}]})",
                           R"({"keys": [{"t": 0, "eye": [0, 0, "x"], "target": [0, 0, 5]}]})",
                           R"({"keys": [{"t": 0, "eye": [0, 0, 5], "target": [0, 0, 0]},
                                        {"t": 0, "eye": [1, 0, 5], "target": [0, 0, 0]}]})"}) {
    const auto path = CameraPath::from_json(text);
    ASSERT_FALSE(path) << text;
    EXPECT_EQ(path.error().code, ErrorCode::kCorrupt);
  }
}

}  // namespace
}  // namespace eigencast
