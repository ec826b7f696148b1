// SPDX-License-Identifier: MIT
#include "client/level_control.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>

#include "tests/unit/view/stage.h"

namespace eigencast {
namespace {

using testing::at;
using testing::sphere_asset;
using testing::Stage;

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

TEST(Levels, ResolversHoldTheRate) {
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
    EXPECT_GT(fps, kind == ResolverKind::kPaper ? 16 : 19.5) << kResolverNames[kind];
    EXPECT_LT(fps, 24) << kResolverNames[kind] << ": the budget is used";
    EXPECT_GT(stage.geometry(0).vertex_count(), stage.geometry(1).vertex_count()) << "the near one is finer";
    EXPECT_GE(stage.geometry(1).vertex_count(), 51u) << "the floor";
  }
}

/// Of the picture's time, on a machine without a graphics card.
double left_of(const PictureQuality& quality) {
  const double pixels = double{quality.scale} * double{quality.scale};
  return (0.4 + 0.6 * pixels) * (quality.samples == 1 ? 0.6 : 1.0) * (quality.ground ? 1.0 : 0.9) *
         (quality.shadow == ShadowQuality::kFull    ? 1.0
          : quality.shadow == ShadowQuality::kSmall ? 0.75
                                                    : 0.55);
}

TEST(Levels, QualityGoesBeforeGeometryAndComesBackWhenStill) {
  Stage stage({sphere_asset(4)}, {at(0, {0, 0, 0})});
  ASSERT_TRUE(stage.turn(0));
  LevelSettings settings;
  settings.kind = ResolverKind::kBudget;
  settings.quality = QualityMode::kAuto;
  settings.target_fps = 20;
  LevelControl control(settings);
  Camera camera;
  camera.set_viewport(640, 480);
  TimeUs now = 0;
  std::optional<FrameWork> last;
  double seconds = 0;
  for (int i = 0; i < 400; ++i) {
    control.choose(stage.scene, stage.list, camera, last);
    stage.turn(now);
    seconds = left_of(control.quality()) * (0.08 + 0.02 * static_cast<double>(stage.scene.vertex_count()) / 2562);
    if (const auto other = control.trial())
      control.measured(left_of(control.quality()), left_of(*other), other->ground ? 1 : 4);
    now += static_cast<TimeUs>(1e6 * seconds);
    last = FrameWork{now, seconds};
  }
  EXPECT_LE(seconds, 1.05 / 20);
  EXPECT_NE(control.quality(), PictureQuality());
  EXPECT_TRUE(control.quality().ground);
  EXPECT_GT(stage.scene.vertex_count(), 2562u / 2);
  const PictureQuality lowered = control.quality();
  EXPECT_TRUE(control.set_still(true));
  EXPECT_FALSE(control.set_still(true)) << "once";
  control.choose(stage.scene, stage.list, camera, last);
  EXPECT_EQ(control.quality(), PictureQuality());
  EXPECT_FALSE(control.set_still(false));
  control.choose(stage.scene, stage.list, camera, FrameWork{now, 0.1});
  EXPECT_EQ(control.quality(), lowered) << "what the still picture took says nothing";
  control.set_kind(ResolverKind::kNone);
  control.choose(stage.scene, stage.list, camera, last);
  EXPECT_EQ(control.quality(), PictureQuality());
}

/// Seconds of a picture of six horses at 1280 x 720 by llvmpipe on two cores, and how it differs from the full one.
double time_of_horses(const PictureQuality& quality, double vertices) {
  const double pixels = double{quality.scale} * double{quality.scale} * (quality.samples == 1 ? 0.016 : 0.047);
  const double shadow = quality.shadow == ShadowQuality::kFull ? 1 : 0.9;
  return (0.006 + 0.035 * vertices + pixels * shadow) * (quality.ground ? 1 : 0.95);
}
double error_of_horses(const PictureQuality& quality) {
  return 0.5 * std::max(1 / double{quality.scale} - 1, 0.0) + (quality.samples == 1 ? 0.18 : 0) +
         (quality.shadow == ShadowQuality::kFull ? 0 : 7.4) + (quality.ground ? 0 : 7.9);
}

TEST(Levels, TheTimeIsUsedWhereOneSampleSavesTooMuch) {
  constexpr double kRate = 15;
  constexpr std::size_t kSettled = 60, kPictures = 420;
  std::vector<double> fifths;
  // Machines on which the whole picture takes 1.15 to 1.55 times its time; horses stride.
  for (double slower = 0.88; slower < 1.18; slower *= 1.02) {
    Stage stage({sphere_asset(5)}, {at(0, {0, 0, 0})});
    ASSERT_TRUE(stage.turn(0));
    LevelSettings settings;
    settings.kind = ResolverKind::kBudget;
    settings.quality = QualityMode::kAuto;
    settings.target_fps = kRate;
    settings.deadline = 1.25;
    LevelControl control(settings);
    Camera camera;
    camera.set_viewport(1280, 720);
    std::mt19937 random(7);
    std::normal_distribution<double> normal;
    std::vector<double> used;
    std::optional<FrameWork> last;
    TimeUs now = 0;
    int changes = 0;
    PictureQuality before;
    for (std::size_t i = 0; i < kPictures; ++i) {
      control.choose(stage.scene, stage.list, camera, last);
      stage.turn(now);
      const double vertices = static_cast<double>(stage.scene.vertex_count()) / 10242;
      const double gait = 1 + 0.1 * std::sin(6.2831853 * static_cast<double>(i) / 26);
      const double seconds =
          slower * gait * time_of_horses(control.quality(), vertices) * std::exp(0.04 * normal(random));
      if (const auto other = control.trial())
        control.measured(time_of_horses(control.quality(), vertices), time_of_horses(*other, vertices),
                         std::abs(error_of_horses(*other) - error_of_horses(control.quality())));
      now += static_cast<TimeUs>(1e6 * seconds);
      last = FrameWork{now, seconds};
      if (i >= kSettled && control.lowered()) used.push_back(seconds * kRate);
      changes += i >= kSettled && control.quality() != before ? 1 : 0;
      before = control.quality();
    }
    ASSERT_GT(used.size(), kPictures / 2) << slower;
    std::sort(used.begin(), used.end());
    EXPECT_LE(used[used.size() / 2], 1) << slower << ": the rate is held";
    EXPECT_LE(changes, 6) << slower;
    fifths.push_back(used[used.size() / 20]);
  }
  EXPECT_GE(*std::min_element(fifths.begin(), fifths.end()), 0.8);
  EXPECT_GE(std::accumulate(fifths.begin(), fifths.end(), 0.0) / static_cast<double>(fifths.size()), 0.83);
}

TEST(Levels, VerticesThatSaveNothingStay) {
  for (const QualityMode quality : {QualityMode::kFull, QualityMode::kAuto}) {
    Stage stage({sphere_asset(3)}, {at(0, {0, 0, 0})});
    ASSERT_TRUE(stage.turn(0));
    LevelSettings settings;
    settings.kind = ResolverKind::kBudget;
    settings.quality = quality;
    settings.target_fps = 30;
    LevelControl control(settings);
    Camera camera;
    camera.set_viewport(640, 480);
    std::mt19937 random(5);
    std::normal_distribution<double> normal;
    std::optional<FrameWork> last;
    TimeUs now = 0;
    for (int i = 0; i < 600; ++i) {
      control.choose(stage.scene, stage.list, camera, last);
      stage.turn(now);
      EXPECT_EQ(stage.scene.vertex_count(), 642u) << "picture " << i;
      const double seconds = (0.039 + 3e-8 * static_cast<double>(stage.scene.vertex_count())) *
                             left_of(control.quality()) * std::exp(0.05 * normal(random));
      if (const auto other = control.trial())
        control.measured(left_of(control.quality()), left_of(*other), other->ground ? 1 : 4);
      now += static_cast<TimeUs>(1e6 * seconds);
      last = FrameWork{now, seconds};
    }
  }
}

TEST(Levels, VerticesGoWhereTheyAreMissed) {
  // Two surfaces of the same size; without half of its vertices one is off four times as far.
  Asset smooth = sphere_asset(4), rough = smooth;
  smooth.level_errors = {{100, 1e-3F, 1e-2F}, {1000, 1e-4F, 1e-3F}};
  rough.level_errors = {{100, 4e-3F, 4e-2F}, {1000, 4e-4F, 4e-3F}};
  const auto levels_of = [](const Asset& left, const Asset& right) {
    Stage stage({left, right}, {at(0, {-1, 0, 0}), at(1, {1, 0, 0})});
    EXPECT_TRUE(stage.turn(0));
    Camera camera;
    camera.set_viewport(640, 480);
    camera.look_from({0, 0, 8}, {0, 0, 0});
    LevelSettings settings;
    settings.kind = ResolverKind::kBudget;
    settings.target_fps = 20;
    LevelControl control(settings);
    mean_fps_of(stage, control, camera, 0.004, 0.146 / 5124);
    return static_cast<double>(stage.geometry(1).vertex_count()) /
           static_cast<double>(stage.geometry(0).vertex_count());
  };
  // There errors fall a little more slowly than as 1 / rows.
  EXPECT_NEAR(levels_of(smooth, rough), 2.2, 0.2);
  EXPECT_NEAR(levels_of(sphere_asset(4), rough), 1, 0.05) << "what is not known is as of the others";
}

TEST(Levels, QualityCanBeFixed) {
  LevelSettings settings;
  settings.quality = QualityMode::kLow;
  const LevelControl low(settings);
  EXPECT_LT(low.quality().scale, 1);
  EXPECT_EQ(low.quality().samples, 1);
  settings.quality = QualityMode::kFull;
  EXPECT_EQ(LevelControl(settings).quality(), PictureQuality());
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

}  // namespace
}  // namespace eigencast
