// SPDX-License-Identifier: MIT
#include "view/scene.h"

#include <gtest/gtest.h>

#include <glm/ext/matrix_transform.hpp>
#include <glm/geometric.hpp>

#include "client/camera_path.h"
#include "client/level_control.h"
#include "client/scene_file.h"
#include "tests/unit/client/fake_source.h"
#include "tests/unit/client/offscreen_pictures.h"

namespace eigencast {
namespace {

using testing::FakeSource;
using testing::sphere_asset;
using testing::sphere_pose;

/// A scene fed by hand: stream i shows what sources[i] is given.
struct Stage {
  explicit Stage(std::vector<Asset> assets, std::vector<Placement> placements, bool row = false)
      : scene(std::move(placements), {}, row) {
    for (Asset& asset : assets) {
      sources.push_back(std::make_unique<FakeSource>(std::move(asset)));
      sources.back()->info_->epoch = 1;
      list.push_back(sources.back().get());
    }
  }
  bool turn(TimeUs now_us) {
    for (std::size_t i = 0; i < list.size(); ++i) scene.receive(i, *list[i], list[i]->poll({}));
    return scene.advance(list, now_us);
  }
  const SurfaceGeometry& geometry(std::size_t i) const { return scene.instances()[i].view.geometry(); }

  std::vector<std::unique_ptr<FakeSource>> sources;
  std::vector<PoseSource*> list;
  Scene scene;
};

Placement at(std::size_t source, const glm::vec3& place) {
  return {source, "", glm::translate(glm::mat4(1), place)};
}

TEST(Scenes, SurfacesOfOneAssetShareItsBasisAndEachHasItsOwnPose) {
  Stage stage({sphere_asset(3), sphere_asset(3)}, {at(0, {0, 0, 0}), at(1, {3, 0, 0}), at(1, {6, 0, 0})});
  for (auto& source : stage.sources) source->info_->asset = "the same";
  stage.sources[0]->batches.push_back({sphere_pose(stage.sources[0]->asset_, 1, 1000, 0.5)});
  stage.sources[1]->batches.push_back({sphere_pose(stage.sources[1]->asset_, 1, 1000, 0.9)});
  ASSERT_TRUE(stage.turn(1000));
  const auto& instances = stage.scene.instances();
  EXPECT_EQ(&instances[0].view.reconstructor(), &instances[1].view.reconstructor());
  EXPECT_EQ(&instances[0].view.reconstructor(), &instances[2].view.reconstructor());
  EXPECT_EQ(stage.geometry(1).positions, stage.geometry(2).positions);
  // As each would be alone.
  for (const std::size_t i : {0, 1}) {
    FakeSource source(sphere_asset(3));
    SurfaceView alone;
    alone.receive(source, {sphere_pose(source.asset_, 1, 1000, i == 0 ? 0.5 : 0.9)});
    ASSERT_TRUE(alone.advance(source, 1000));
    ASSERT_EQ(alone.geometry().positions.size(), stage.geometry(i).positions.size());
    for (std::size_t k = 0; k < alone.geometry().positions.size(); ++k)
      ASSERT_NEAR(alone.geometry().positions[k], stage.geometry(i).positions[k], 1e-6);
    EXPECT_EQ(alone.geometry().triangles, stage.geometry(i).triangles);
  }
  EXPECT_EQ(stage.scene.vertex_count(), 3u * 642);
  EXPECT_EQ(stage.scene.triangle_count(), 3u * 1280);
  EXPECT_EQ(stage.scene.poses_shown(), 1u);
}

TEST(Scenes, ManySurfacesStandInRowsBehindOneAnother) {
  for (const auto up : {Asset::UpAxis::kY, Asset::UpAxis::kZ}) {
    std::vector<Asset> assets(20, sphere_asset(1));
    std::vector<Placement> placements;
    for (std::size_t i = 0; i < assets.size(); ++i) {
      assets[i].up_axis = up;
      placements.push_back({i, "", glm::mat4(1)});
    }
    Stage stage(assets, placements, true);
    ASSERT_TRUE(stage.turn(1000));
    const int away = up == Asset::UpAxis::kZ ? 1 : 2;
    const float step = 2.24F, sign = up == Asset::UpAxis::kZ ? 1.0F : -1.0F;
    for (std::size_t i = 0; i < assets.size(); ++i) {
      const glm::vec3 place(stage.scene.instances()[i].scene_from_surface[3]);
      glm::vec3 wanted{0};
      wanted.x = static_cast<float>(i % 6) * (step + 0.24F);
      wanted[away] = sign * static_cast<float>(i / 6) * step;
      EXPECT_LT(glm::length(place - wanted), 0.01F) << i << ": " << place.x << ' ' << place.y << ' ' << place.z;
    }
  }
}

TEST(Scenes, AnAssetThatGoesTakesItsBasisAlongAndAnotherOfTheSameNameIsItsOwn) {
  Stage stage({sphere_asset(2)}, {at(0, {0, 0, 0})});
  stage.sources[0]->info_->asset = "a";
  ASSERT_TRUE(stage.turn(0));
  stage.sources[0]->asset_ = sphere_asset(3);
  stage.sources[0]->epoch_ = 2;
  stage.sources[0]->info_->epoch = 2;
  stage.sources[0]->info_->asset = "b";
  ASSERT_TRUE(stage.turn(1000));
  EXPECT_EQ(stage.geometry(0).vertex_count(), 642u);
  EXPECT_EQ(stage.scene.instances()[0].view.reconstructor().tiles().rows(), 642u);
}

TEST(Scenes, TheStreamsWorldComesFirstAndThenThePlacement) {
  Stage stage({sphere_asset(2)}, {at(0, {10, 0, 0})});
  glm::mat4 world = glm::scale(glm::translate(glm::mat4(1), {0, 1, 0}), glm::vec3(2));
  stage.sources[0]->info_->world = std::vector<double>(&world[0][0], &world[0][0] + 16);
  ASSERT_TRUE(stage.turn(0));
  const SurfaceFacts& facts = stage.scene.facts();
  EXPECT_EQ(facts.version, 1u);
  EXPECT_NEAR(facts.low[0], 8, 0.05);
  EXPECT_NEAR(facts.high[0], 12, 0.05);
  EXPECT_NEAR(facts.low[1], -1, 0.05);
  EXPECT_NEAR(facts.high[1], 3, 0.05);
  const Extent extent = extent_of(stage.scene.instances()[0]);
  EXPECT_NEAR(glm::length(extent.barycentre - glm::vec3(10, 1, 0)), 0, 0.01);
  EXPECT_NEAR(extent.radius, 2 * std::sqrt(3.0), 0.1);
}

TEST(Scenes, StreamsWithoutAPlaceStandBesideOneAnother) {
  Stage stage({sphere_asset(2), sphere_asset(2), sphere_asset(2)},
              {{0, "", glm::mat4(1)}, {1, "", glm::mat4(1)}, {2, "", glm::mat4(1)}}, true);
  ASSERT_TRUE(stage.turn(0));
  for (std::size_t i = 1; i < 3; ++i) {
    const float gap =
        stage.scene.instances()[i].scene_from_surface[3].x - stage.scene.instances()[i - 1].scene_from_surface[3].x;
    EXPECT_GT(gap, 2.1) << "of balls of radius 1";
    EXPECT_LT(gap, 2.8);
  }
  EXPECT_GT(stage.scene.facts().high[0] - stage.scene.facts().low[0], 6);
}

TEST(Scenes, TheBarycentreFollowsThePose) {
  Stage stage({sphere_asset(3)}, {at(0, {0, 0, 0})});
  stage.sources[0]->batches.push_back({sphere_pose(stage.sources[0]->asset_, 1, 1000, 0.7, 1.5)});
  ASSERT_TRUE(stage.turn(1000));
  const auto& positions = stage.geometry(0).positions;
  double sum[3] = {};
  for (std::size_t i = 0; i < positions.size(); ++i) sum[i % 3] += static_cast<double>(positions[i]);  // equal masses
  const auto barycentre = stage.scene.instances()[0].view.barycentre();
  for (std::size_t d = 0; d < 3; ++d)
    EXPECT_NEAR(barycentre[d], sum[d] / static_cast<double>(positions.size() / 3), 1e-5);
  EXPECT_NEAR(barycentre[0], 1.5, 1e-3);
}

TEST(Scenes, WhatIsOutOfSightHasNoSizeAndABallHasThatOfItsSilhouette) {
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
  EXPECT_NEAR(camera.most_px_per_unit({0, 0, 0}, 1), focal / 9, 0.01);
  EXPECT_TRUE(std::isinf(camera.most_px_per_unit({0, 0, 9.5F}, 1)));
}

TEST(Scenes, LookingFromAPlaceIsTheViewThatWasAskedFor) {
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

/// Turns of a machine on which a picture takes fixed + per_vertex x vertices, without a display to wait for.
double mean_fps_of(Stage& stage, LevelControl& control, const Camera& camera, double fixed, double per_vertex) {
  TimeUs now = 0;
  std::optional<FrameWork> last;
  int frames = 0;
  TimeUs counted_from = 0;
  for (; now < 12'000'000; ++frames) {
    if (counted_from == 0 && now > 6'000'000) counted_from = now, frames = 0;
    control.choose(stage.scene, stage.list, camera, last);
    stage.turn(now);
    const double seconds = fixed + per_vertex * static_cast<double>(stage.scene.vertex_count());
    now += static_cast<TimeUs>(1e6 * seconds);
    last = FrameWork{now, seconds};
  }
  return frames / (static_cast<double>(now - counted_from) / 1e6);
}

TEST(Levels, BothResolversHoldTheRateOfAMachineThatFullDetailIsTooMuchFor) {
  for (const ResolverKind kind : {ResolverKind::kBudget, ResolverKind::kPaper, ResolverKind::kNone}) {
    Stage stage({sphere_asset(4), sphere_asset(4)}, {at(0, {0, 0, 0}), at(1, {6, 0, -8})});
    ASSERT_TRUE(stage.turn(0));
    Camera camera;
    camera.set_viewport(640, 480);
    camera.look_from({0, 0, 8}, {2, 0, 0});
    LevelSettings settings;
    settings.kind = kind;
    settings.target_fps = 20;
    settings.far = 40;
    LevelControl control(settings);
    const double fps = mean_fps_of(stage, control, camera, 0.004, 0.146 / 5124);  // 150 ms at full detail
    if (kind == ResolverKind::kNone) {
      EXPECT_NEAR(fps, 1 / 0.150, 0.1);
      EXPECT_EQ(stage.scene.vertex_count(), 5124u);
      continue;
    }
    EXPECT_GT(fps, kind == ResolverKind::kPaper ? 16 : 19.5) << name_of(kind);
    EXPECT_LT(fps, 24) << name_of(kind) << ": the budget is used";
    EXPECT_GT(stage.geometry(0).vertex_count(), stage.geometry(1).vertex_count()) << "the near one is finer";
    EXPECT_GE(stage.geometry(1).vertex_count(), 51u) << "the floor";
  }
}

TEST(Levels, TheManualLevelBoundsTheResolver) {
  Stage stage({sphere_asset(4)}, {at(0, {0, 0, 0})});
  ASSERT_TRUE(stage.turn(0));
  stage.scene.lod().set_fraction(0.3);
  LevelSettings settings;
  settings.kind = ResolverKind::kBudget;
  LevelControl control(settings);
  Camera camera;
  mean_fps_of(stage, control, camera, 1e-3, 1e-9);
  EXPECT_NEAR(stage.geometry(0).vertex_count(), 0.3 * 2562, 1);
  control.set_kind(ResolverKind::kNone);
  stage.scene.lod().set_fraction(1);
  control.choose(stage.scene, stage.list, camera, std::nullopt);
  stage.turn(20'000'000);
  EXPECT_EQ(stage.geometry(0).vertex_count(), 2562u);
}

using ScenePictures = testing::OffscreenPictures;

TEST_F(ScenePictures, EachSurfaceIsDrawnAtItsPlaceAndMayBeHidden) {
  Stage stage({sphere_asset(3)}, {at(0, {-2, 0, 0}), at(0, {2, 0, 0})});
  ASSERT_TRUE(stage.turn(0));
  camera_.set_viewport(320, 160);
  camera_.set_view("front");
  frame(stage.scene.facts());
  renderer_->set_surface_count(2);
  const auto is_clay_at = [&](const Picture& picture, const glm::vec3& place) {
    const auto px = camera_.pixel_from_scene(place);
    return testing::is_clay(picture.pixel(static_cast<int>(px->x), static_cast<int>(px->y)));
  };
  for (const bool second_visible : {true, false}) {
    for (std::size_t i = 0; i < 2; ++i) {
      renderer_->upload(i, stage.geometry(i));
      renderer_->place(i, stage.scene.instances()[i].scene_from_surface, i == 0 || second_visible);
    }
    const auto picture = renderer_->picture(camera_, {}, 320, 160);
    ASSERT_TRUE(picture);
    EXPECT_TRUE(is_clay_at(*picture, {-2, 0, 0}));
    EXPECT_EQ(is_clay_at(*picture, {2, 0, 0}), second_visible);
    EXPECT_FALSE(is_clay_at(*picture, {0, 0, 0}));
  }
  renderer_->set_surface_count(1);
  const auto picture = renderer_->picture(camera_, {}, 320, 160);
  ASSERT_TRUE(picture);
  EXPECT_TRUE(is_clay_at(*picture, {-2, 0, 0}));
}

TEST(SceneFiles, SurfacesNameTheirStreamsAndPlaces) {
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

TEST(SceneFiles, WhatIsWrongIsNamed) {
  const std::vector<std::pair<const char*, const char*>> wrong{
      {"", "scene"},
      {"[]", "scene"},
      {R"({"surfaces": []})", "scene"},
      {R"({"surfaces": [7]})", "surfaces[0]"},
      {R"({"surfaces": [{"name": "x"}]})", "stream"},
      {R"({"surfaces": [{"stream": "ws://h/a", "file": "heart"}]})", "either"},
      {R"({"surfaces": [{"file": 7}]})", "either"},
      {R"({"surfaces": [{"stream": "ws://h/a", "positon": [0, 0, 0]}]})", "positon"},
      {R"({"surfaces": [{"stream": "ws://h/a", "position": [0, 0]}]})", "surfaces[0].position"},
      {R"({"surfaces": [{"stream": "ws://h/a", "position": [0, 0, 1e39]}]})", "finite"},
      {R"({"surfaces": [{"stream": "ws://h/a", "scale": 0}]})", "scale"},
      {R"({"surfaces": [{"stream": "ws://h/a", "rotation_deg": [0, 0, 0, 9]}]})", "axis"},
      {R"({"surfaces": [{"stream": "ws://h/a", "name": 7}]})", "name"}};
  for (const auto& [text, named] : wrong) {
    const auto scene = scene_from_json(text);
    ASSERT_FALSE(scene) << text;
    EXPECT_NE(scene.error().message.find(named), std::string::npos) << scene.error().message;
  }
  std::string many = R"({"surfaces": [)";
  for (std::size_t i = 0; i <= kMostSurfaces; ++i) many += R"({"stream": "ws://h/a"},)";
  many.back() = ']';
  EXPECT_EQ(scene_from_json(many + "}").error().code, ErrorCode::kTooLarge);
  EXPECT_EQ(read_scene_file("/nonexistent/scene.json").error().code, ErrorCode::kIo);
}

TEST(CameraPaths, PassesThroughItsKeysAndMovesEvenlyBetweenThem) {
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

TEST(CameraPaths, WhatIsWrongIsNamed) {
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
