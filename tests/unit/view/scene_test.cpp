// SPDX-License-Identifier: MIT
#include "view/scene.h"

#include <gtest/gtest.h>

#include <glm/ext/matrix_transform.hpp>
#include <glm/geometric.hpp>

#include "tests/unit/view/fake_source.h"
#include "tests/unit/view/offscreen_pictures.h"
#include "tests/unit/view/stage.h"

namespace eigencast {
namespace {

using testing::at;
using testing::FakeSource;
using testing::sphere_asset;
using testing::sphere_pose;
using testing::Stage;

TEST(Scenes, SurfacesOfOneAssetShareItsBasis) {
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
    ASSERT_TRUE(testing::advance(alone, source, 1000));
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
      const glm::vec3 position(stage.scene.instances()[i].scene_from_surface[3]);
      glm::vec3 wanted{0};
      wanted.x = static_cast<float>(i % 6) * (step + 0.24F);
      wanted[away] = sign * static_cast<float>(i / 6) * step;
      EXPECT_LT(glm::length(position - wanted), 0.01F)
          << i << ": " << position.x << ' ' << position.y << ' ' << position.z;
    }
  }
}

TEST(Scenes, NewAssetGetsItsOwnBasis) {
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

TEST(Scenes, WorldIsAppliedBeforePlacement) {
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

TEST(Scenes, StreamsWithoutWorldFormARow) {
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

/// Of a broker of its own, which says how late its group is.
class SyncedSource final : public FakeSource {
 public:
  SyncedSource() : FakeSource(sphere_asset(1)) {}
  std::optional<SharedMoment> moment() const override { return moment_; }
  void report_late(TimeUs needed_lag_us) override { late_us = needed_lag_us; }
  std::optional<SharedMoment> moment_;
  std::optional<TimeUs> late_us;
};

TEST(Scenes, StreamsOfSeveralBrokersAreAsLateAsTheLatestOfThem) {
  SyncedSource near, far;
  PoseSource* const sources[] = {&near, &far};
  Scene scene({at(0, {0, 0, 0}), at(1, {3, 0, 0})},
              {.playout = {.mode = PlayoutMode::kEstimate, .smoothness = 1}, .lod = 1});
  const auto lag_of = [&](std::size_t i) { return scene.instances()[i].view.playout().lag_us(); };
  // Poses of one sender's clock; the far ones come 100 ms later.
  for (std::uint64_t k = 1; k < 6; ++k) {
    const auto time_us = static_cast<TimeUs>(k) * 33'000;
    ReceivedPose one = sphere_pose(near.asset_, k, time_us, 1), other = one;
    one.arrival_us += 5'000;
    other.arrival_us += 105'000;
    scene.receive(0, near, {one});
    scene.receive(1, far, {other});
    scene.advance(sources, time_us + 105'000);
  }
  ASSERT_TRUE(near.late_us && far.late_us);
  EXPECT_FALSE(lag_of(0)) << "no broker has said anything";
  const TimeUs near_needs = *near.late_us, far_needs = *far.late_us;
  EXPECT_EQ(far_needs, near_needs + 100'000);
  // At both brokers poses arrive 5 ms after their capture; each knows its own viewers alone.
  near.moment_ = {45'000, 40'000};
  far.moment_ = {135'000, 130'000};
  scene.advance(sources, 400'000);
  EXPECT_EQ(lag_of(0), 135'000);
  EXPECT_EQ(lag_of(1), 135'000);
  EXPECT_EQ(near.late_us, far_needs) << "what this viewer needs, not what a broker says";
  EXPECT_EQ(far.late_us, far_needs);
  far.moment_.reset();
  scene.advance(sources, 400'000);
  EXPECT_EQ(lag_of(0), 45'000);
  EXPECT_FALSE(lag_of(1)) << "it shows the past, or there is a new connection";
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

using ScenePictures = testing::OffscreenPictures;

TEST_F(ScenePictures, SurfacesAreDrawnWherePlacedOrHidden) {
  Stage stage({sphere_asset(3)}, {at(0, {-2, 0, 0}), at(0, {2, 0, 0})});
  ASSERT_TRUE(stage.turn(0));
  camera_.set_viewport(320, 160);
  camera_.set_view("front");
  frame(stage.scene.facts());
  renderer_->set_surface_count(2);
  const auto is_clay_at = [&](const Picture& picture, const glm::vec3& position) {
    const auto px = camera_.pixel_from_scene(position);
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

}  // namespace
}  // namespace eigencast
