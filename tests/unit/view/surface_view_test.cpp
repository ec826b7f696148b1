// SPDX-License-Identifier: MIT
#include "view/surface_view.h"
#include "view/camera.h"

#include <gtest/gtest.h>

#include "tests/unit/view/fake_source.h"

namespace eigencast {
namespace {

using testing::FakeSource;
using testing::sphere_asset;
using testing::sphere_pose;

class SurfaceViews : public ::testing::Test {
 protected:
  bool turn(TimeUs now_us) {
    scene_.receive(source_, source_.poll({}));
    return testing::advance(scene_, source_, now_us);
  }
  /// Half the height of the surface shown.
  float height() const {
    float highest = 0;
    for (std::size_t i = 1; i < scene_.geometry().positions.size(); i += 3) {
      highest = std::max(highest, scene_.geometry().positions[i]);
    }
    return highest;
  }

  FakeSource source_{sphere_asset(3)};
  SurfaceView scene_;
};

TEST_F(SurfaceViews, FixtureIsAValidAsset) {
  EXPECT_TRUE(validate_asset(source_.asset_));
}

TEST_F(SurfaceViews, ShowsTheRestPoseBeforeAnyPoseCame) {
  EXPECT_TRUE(turn(0));
  EXPECT_EQ(scene_.geometry().vertex_count(), 642u);
  EXPECT_EQ(scene_.geometry().triangles.size(), 3u * 1280);
  EXPECT_NEAR(height(), 1, 0.01);
  EXPECT_EQ(scene_.poses_shown(), 0u);
  EXPECT_NEAR(scene_.facts().low[0], -1, 0.03);
  EXPECT_FALSE(turn(1)) << "nothing changed";
}

TEST_F(SurfaceViews, ShowsTheNewestPoseAndOnlyOnce) {
  source_.batches.push_back({sphere_pose(source_.asset_, 1, 1000, 0.5), sphere_pose(source_.asset_, 2, 2000, 0.8)});
  EXPECT_TRUE(turn(2000));
  EXPECT_NEAR(height(), 0.8, 0.01);
  EXPECT_EQ(scene_.shown_capture_us(), 2000);
  EXPECT_EQ(scene_.bands_received(), 2u);
  EXPECT_FALSE(turn(3000));
  EXPECT_EQ(scene_.poses_shown(), 1u);
}

TEST_F(SurfaceViews, WhoRestsDoesNotMove) {
  const auto given = [&](std::uint64_t sequence, float height) {
    source_.batches.push_back({sphere_pose(source_.asset_, sequence, 1000 * static_cast<TimeUs>(sequence), height)});
    return turn(1000 * static_cast<TimeUs>(sequence));
  };
  EXPECT_TRUE(given(1, 0.5F));
  for (std::uint64_t sequence = 2; sequence < 5; ++sequence) EXPECT_FALSE(given(sequence, 0.5F));
  EXPECT_EQ(scene_.poses_shown(), 4u);
  EXPECT_EQ(scene_.shown_capture_us(), 4000);
  EXPECT_EQ(scene_.moves(), 1u);
  EXPECT_TRUE(given(5, 0.8F));
  EXPECT_NEAR(height(), 0.8, 0.01);
  EXPECT_EQ(scene_.moves(), 2u);
}

TEST_F(SurfaceViews, NormalsAreUnitAndPointOutward) {
  turn(0);
  const auto& g = scene_.geometry();
  for (std::size_t i = 0; i < g.positions.size(); i += 3) {
    const float* n = &g.normals[i];
    const float* x = &g.positions[i];
    EXPECT_NEAR(n[0] * n[0] + n[1] * n[1] + n[2] * n[2], 1, 1e-4);
    EXPECT_GT(n[0] * x[0] + n[1] * x[1] + n[2] * x[2], 0.9);
  }
}

TEST_F(SurfaceViews, ALostConnectionKeepsTheLastPose) {
  source_.batches.push_back({sphere_pose(source_.asset_, 1, 1000, 0.5)});
  turn(1000);
  source_.stats_.state = Subscriber::State::kLost;
  for (TimeUs now = 2000; now < 9'000'000; now += 1'000'000) EXPECT_FALSE(turn(now));
  EXPECT_NEAR(height(), 0.5, 0.01);
  source_.stats_.state = Subscriber::State::kLive;
  source_.batches.push_back({sphere_pose(source_.asset_, 7, 9'500'000, 0.9)});
  EXPECT_TRUE(turn(9'500'000));
  EXPECT_NEAR(height(), 0.9, 0.01);
}

TEST_F(SurfaceViews, PausedShowsTheSamePoseWhileOthersCome) {
  source_.batches.push_back({sphere_pose(source_.asset_, 1, 1000, 0.5)});
  turn(1000);
  scene_.set_paused(true);
  source_.batches.push_back({sphere_pose(source_.asset_, 2, 2000, 0.8)});
  EXPECT_FALSE(turn(2000));
  EXPECT_NEAR(height(), 0.5, 0.01);
  scene_.set_paused(false);
  EXPECT_TRUE(turn(2001));
  EXPECT_NEAR(height(), 0.8, 0.01);
}

TEST_F(SurfaceViews, LevelsAreClampedWhileTheAssetArrives) {
  Asset& asset = source_.asset_;
  asset.rows_ready = 5;  // not even the base
  asset.faces_ready = 0;
  EXPECT_FALSE(turn(0));
  asset.rows_ready = 162;
  asset.faces_ready = 320;
  EXPECT_TRUE(turn(1));
  EXPECT_EQ(scene_.geometry().vertex_count(), 162u);
  EXPECT_EQ(scene_.geometry().triangles.size(), 3u * 320);
  scene_.lod().set_fraction(0);
  EXPECT_TRUE(turn(2));
  EXPECT_GE(scene_.geometry().vertex_count(), asset.base_count);
  scene_.lod().set_fraction(1);
  asset.rows_ready = asset.vertex_count;
  asset.faces_ready = asset.face_total;
  EXPECT_TRUE(turn(3));
  EXPECT_EQ(scene_.geometry().vertex_count(), asset.vertex_count);
}

TEST_F(SurfaceViews, AllTrianglesStayBelowTheLevel) {
  for (const double fraction : {0.02, 0.1, 0.3, 0.77}) {
    scene_.lod().set_fraction(fraction);
    turn(0);
    const auto N = scene_.geometry().vertex_count();
    EXPECT_NEAR(N, fraction * 642, 1);
    for (const std::uint32_t corner : scene_.geometry().triangles) ASSERT_LT(corner, N);
  }
}

TEST_F(SurfaceViews, PosesOfWrongSizeAreNotShown) {
  ReceivedPose wrong = sphere_pose(source_.asset_, 2, 2000, 0.5);
  wrong.coefficients.edit().resize(12);
  source_.batches.push_back({wrong});
  turn(2000);
  EXPECT_EQ(scene_.poses_shown(), 0u);
  EXPECT_EQ(scene_.poses_unusable(), 1u);
  EXPECT_NEAR(height(), 1, 0.01);
}

TEST_F(SurfaceViews, NewAssetStartsAtItsRestPose) {
  source_.info_->epoch = 1;
  source_.info_->asset = "a";
  source_.batches.push_back({sphere_pose(source_.asset_, 1, 1000, 0.5)});
  turn(1000);
  source_.info_->epoch = 2;  // announced; its surface has not arrived
  source_.info_->asset = "b";
  EXPECT_FALSE(turn(2000)) << "the old surface stays";
  EXPECT_NEAR(height(), 0.5, 0.01);
  source_.asset_ = sphere_asset(2);
  source_.epoch_ = 2;
  EXPECT_TRUE(turn(3000));
  EXPECT_EQ(scene_.geometry().vertex_count(), 162u);
  EXPECT_NEAR(height(), 1, 0.01);
  source_.batches.push_back({sphere_pose(source_.asset_, 1, 50, 0.7, 0, 2)});
  EXPECT_TRUE(turn(4000));
  EXPECT_NEAR(height(), 0.7, 0.01);
}

TEST_F(SurfaceViews, ReturningSenderKeepsThePose) {
  source_.info_->epoch = 1;
  source_.info_->asset = "a";
  source_.batches.push_back({sphere_pose(source_.asset_, 1, 9'000'000, 0.5)});
  turn(1000);
  const auto facts = scene_.facts().version, topology = scene_.geometry().topology_version;
  source_.info_->epoch = source_.epoch_ = 2;
  for (const TimeUs now : {2000, 3000, 4000}) {
    turn(now);
    EXPECT_NEAR(height(), 0.5, 0.01);
  }
  scene_.lod().set_fraction(0.5);
  EXPECT_TRUE(turn(1'005'000));
  EXPECT_NEAR(height(), 0.5, 0.01) << "also when something else changes";
  scene_.lod().set_fraction(1);
  turn(2'006'000);
  source_.batches.push_back({sphere_pose(source_.asset_, 1, 50, 0.7, 0, 2)});
  EXPECT_TRUE(turn(2'007'000)) << "its clock is a new one: earlier times count";
  EXPECT_NEAR(height(), 0.7, 0.01);
  EXPECT_EQ(scene_.facts().version, facts) << "the camera has nothing new to frame";
  EXPECT_EQ(scene_.geometry().topology_version, topology + 2);
}

TEST_F(SurfaceViews, PauseSurvivesSenderWithMoreChannels) {
  source_.info_->epoch = 1;
  source_.info_->asset = "a";
  source_.batches.push_back({sphere_pose(source_.asset_, 1, 1000, 0.5)});
  turn(1000);
  scene_.set_paused(true);
  source_.info_->epoch = source_.epoch_ = 2;
  ReceivedPose wider = sphere_pose(source_.asset_, 1, 50, 0.7, 0, 2);
  wider.channels = 4;
  wider.coefficients.edit().assign(24, 0.25);
  source_.batches.push_back({wider});
  EXPECT_FALSE(turn(2000));
  scene_.lod().set_fraction(0.5);
  EXPECT_TRUE(turn(3000));
  EXPECT_NEAR(height(), 0.5, 0.01);
}

TEST_F(SurfaceViews, ABandThatComesOrGoesIsFaded) {
  // Band 1 holds row 5 (y^2 - 1/3): at the pole it adds two thirds of its coefficient to the height.
  const auto pose = [&](std::uint64_t sequence, TimeUs time_us, bool with_band) {
    ReceivedPose made = sphere_pose(source_.asset_, sequence, time_us, 1);
    made.envelope.bands = with_band ? 3 : 1;
    if (with_band) made.coefficients.edit()[5 * 3 + 1] = 0.6;
    return made;
  };
  TimeUs start = 10'000'000;
  float before = 1;
  for (const bool with_band : {false, true, false}) {
    start += 1'000'000;
    const float after = with_band ? 1.4F : 1;
    source_.batches.push_back({pose(static_cast<std::uint64_t>(start), start, with_band)});
    const auto shown = scene_.poses_shown();
    turn(start);
    EXPECT_NEAR(height(), before, 0.01) << "no snap";
    for (const TimeUs passed : {30'000, 75'000, 120'000}) {
      EXPECT_EQ(turn(start + passed), before != after) << "no new pose is needed";
      EXPECT_NEAR(height(), before + (after - before) * static_cast<float>(passed) / 150'000, 0.01);
    }
    turn(start + 150'000);
    EXPECT_NEAR(height(), after, 0.01);
    EXPECT_FALSE(turn(start + 160'000));
    EXPECT_EQ(scene_.poses_shown(), shown + 1) << "one pose, however many pictures";
    before = after;
  }
}

TEST_F(SurfaceViews, FadeEndsWithoutStreamInfo) {
  source_.batches.push_back({sphere_pose(source_.asset_, 1, 1000, 1)});
  source_.batches.front()[0].coefficients.edit()[5 * 3 + 1] = 0.6;
  turn(1000);
  source_.batches.push_back({sphere_pose(source_.asset_, 2, 2000, 1)});
  source_.batches.front()[0].envelope.bands = 1;
  EXPECT_FALSE(turn(2000)) << "it begins to fade";
  source_.info_->format = {};  // as while the broker waits for a sender
  EXPECT_TRUE(turn(3000));
  EXPECT_FALSE(turn(4000));
}

TEST_F(SurfaceViews, BandsOfStepsAreFollowed) {
  const auto key = [&](std::uint64_t sequence, TimeUs time_us, std::uint8_t bands) {
    ReceivedPose step = sphere_pose(source_.asset_, sequence, time_us, 1);
    step.envelope.kind = FrameKind::kStep;
    step.envelope.bands = bands;
    if (bands == 3) step.coefficients.edit()[5 * 3 + 1] = 0.6;
    return std::vector<ReceivedPose>{step};
  };
  source_.batches.push_back(key(1, 1'000'000, 3));
  turn(1'000'000);
  EXPECT_NEAR(height(), 1.4, 0.01);
  EXPECT_EQ(scene_.bands_received(), 2u);
  source_.batches.push_back(key(2, 1'060'000, 1));
  turn(1'060'000);
  EXPECT_NEAR(height(), 1.4, 0.01);
  EXPECT_EQ(scene_.bands_received(), 1u);
  turn(1'135'000);
  EXPECT_NEAR(height(), 1.2, 0.01);
}

TEST(SurfaceViewInterpolated, MovesTowardsAKeySentAhead) {
  FakeSource source(sphere_asset(2));
  SceneOptions options;
  options.playout.mode = PlayoutMode::kInterpolate;
  options.playout.delay_us = 20'000;
  SurfaceView scene(options);
  ReceivedPose step = sphere_pose(source.asset_, 1, 100'000, 0.5);
  step.envelope.kind = FrameKind::kStep;
  step.next = {140'000, 3, sphere_pose(source.asset_, 1, 140'000, 0.9).coefficients};
  source.batches.push_back({step});
  scene.receive(source, source.poll({}));
  testing::advance(scene, source, 120'000);
  testing::advance(scene, source, 150'000);  // Media time 130 ms: three quarters of the way.
  float highest = 0;
  for (std::size_t i = 1; i < scene.geometry().positions.size(); i += 3)
    highest = std::max(highest, scene.geometry().positions[i]);
  EXPECT_NEAR(highest, 0.8, 0.02);
}

TEST(SurfaceViewInterpolated, ShowsPosesBetweenArrivals) {
  FakeSource source(sphere_asset(2));
  SceneOptions options;
  options.playout.mode = PlayoutMode::kInterpolate;
  options.playout.delay_us = 100'000;
  SurfaceView scene(options);
  for (int i = 0; i < 4; ++i) {
    source.batches.push_back({sphere_pose(source.asset_, static_cast<std::uint64_t>(i), i * 50'000, 0.5 + 0.1 * i)});
    scene.receive(source, source.poll({}));
    testing::advance(scene, source, i * 50'000);
  }
  testing::advance(scene, source,
                   175'000);  // 100 ms of delay: media time 75 ms, half-way between the second and the third
  float highest = 0;
  for (std::size_t i = 1; i < scene.geometry().positions.size(); i += 3) {
    highest = std::max(highest, scene.geometry().positions[i]);
  }
  EXPECT_NEAR(highest, 0.65, 0.02);
}

TEST(SurfaceViewInterpolated, DelayFollowsTheStreamUnlessGiven) {
  // 15 keys a second that rise evenly, drawn at 60 Hz: every picture must show about as much motion as the others.
  FakeSource source(sphere_asset(1));
  SceneOptions options;
  options.playout.mode = PlayoutMode::kInterpolate;
  SurfaceView scene(options);
  constexpr TimeUs kKeyUs = 1'000'000 / 15, kPictureUs = 1'000'000 / 60;
  const auto position = [&] { return scene.geometry().positions[0]; };
  std::uint64_t keys = 0;
  std::optional<float> last;
  for (TimeUs now = 0; now < 4'000'000; now += kPictureUs) {
    std::vector<ReceivedPose> poses;
    for (; static_cast<TimeUs>(keys) * kKeyUs <= now; ++keys) {
      const TimeUs time_us = static_cast<TimeUs>(keys) * kKeyUs;
      poses.push_back(sphere_pose(source.asset_, keys + 1, time_us, 1, static_cast<double>(time_us) / 1e6));
    }
    source.batches.push_back(poses);
    scene.receive(source, source.poll({}));
    testing::advance(scene, source, now);
    if (now > 1'000'000) {
      ASSERT_TRUE(last);
      EXPECT_NEAR(position() - *last, 1.0 / 60, 0.3 / 60) << now;
    }
    last = position();
  }
}

TEST(SurfaceViewInterpolated, LostBandFadesAndIsNeverMixed) {
  // The height is 1 + 2/3 of row 5, which is in band 1: 1.4 with it, 1 without it. Poses come 20 ms apart.
  FakeSource source(sphere_asset(3));
  SceneOptions options;
  options.playout.mode = PlayoutMode::kInterpolate;
  SurfaceView scene(options);
  std::vector<float> heights;
  for (int i = 0; i < 60; ++i) {
    const TimeUs time_us = i * 20'000;
    ReceivedPose pose = sphere_pose(source.asset_, static_cast<std::uint64_t>(i + 1), time_us, 1);
    pose.envelope.bands = i < 30 ? 3 : 1;
    if (i < 30) pose.coefficients.edit()[5 * 3 + 1] = 0.6;
    source.batches.push_back({pose});
    scene.receive(source, source.poll({}));
    testing::advance(scene, source, time_us);
    float highest = 0;
    for (std::size_t v = 1; v < scene.geometry().positions.size(); v += 3)
      highest = std::max(highest, scene.geometry().positions[v]);
    heights.push_back(highest);
  }
  EXPECT_NEAR(heights[29], 1.4, 0.01);
  EXPECT_NEAR(heights.back(), 1, 0.01);
  for (std::size_t i = 30; i < heights.size(); ++i)
    EXPECT_LE(heights[i - 1] - heights[i], 0.4 * 20 / 150 + 0.01) << "no faster than the fade, picture " << i;
}

TEST(SurfaceViewInterpolated, WrongEstimateIsDrawnUntilSettled) {
  FakeSource source(sphere_asset(1));
  SceneOptions options;
  options.playout.mode = PlayoutMode::kEstimate;
  SurfaceView scene(options);
  for (int i = 0; i < 6; ++i) {  // Moves by 0.1 a pose, and then not at all.
    const double shift = 0.1 * std::min(i, 4);
    source.batches.push_back({sphere_pose(source.asset_, static_cast<std::uint64_t>(i + 1), i * 50'000, 1, shift)});
    scene.receive(source, source.poll({}));
    testing::advance(scene, source, i * 50'000);
    if (i < 5) testing::advance(scene, source, i * 50'000 + 40'000);
  }
  EXPECT_TRUE(scene.settling());
  TimeUs now = 250'000;
  while (scene.settling() && now < 1'000'000) testing::advance(scene, source, now += 10'000);
  EXPECT_LE(now, 250'000 + Correction::kBlendUs + 10'000);
  EXPECT_NEAR(scene.coefficients()[0], 0.4, 1e-9);
  EXPECT_GT(scene.times_shown()[static_cast<std::size_t>(Shown::kEstimated)], 0U);
}

TEST(SurfaceViewPoints, ACloudHasSpacingAndNoNormals) {
  FakeSource source(sphere_asset(3, true));
  SurfaceView scene;
  scene.receive(source, source.poll({}));
  ASSERT_TRUE(testing::advance(scene, source, 0));
  EXPECT_TRUE(scene.geometry().is_point_cloud);
  EXPECT_TRUE(scene.geometry().normals.empty());
  EXPECT_NEAR(scene.geometry().point_spacing, std::sqrt(12.566F / 642), 1e-3);
}

TEST(SurfaceView, OutlineHoldsMotionThatIsKnown) {
  struct MovingSource final : FakeSource {
    explicit MovingSource(Asset asset) : FakeSource(std::move(asset)) {
      for (const double shift : {0.0, 3.0, 1.0})
        poses.push_back(testing::sphere_pose(asset_, 1, 1, 1, shift).coefficients.edit());
    }
    std::span<const std::vector<double>> motion() const override { return poses; }
    std::vector<std::vector<double>> poses;
  };
  MovingSource source(sphere_asset(2));
  SurfaceView view;
  view.receive(source, {});
  ASSERT_TRUE(testing::advance(view, source, 0));
  Bounds outline;
  for (const glm::vec3& point : view.facts().outline) outline.add(point);
  EXPECT_NEAR(outline.low.x, -1, 0.05);
  EXPECT_NEAR(outline.high.x, 4, 0.05);
  EXPECT_NEAR(view.facts().high.x, 1, 0.05) << "the box is of the surface at rest";
}

}  // namespace
}  // namespace eigencast
