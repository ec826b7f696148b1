// SPDX-License-Identifier: MIT
#include "view/paint.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "tests/unit/view/fake_source.h"
#include "view/style.h"

namespace eigencast {
namespace {

using testing::FakeSource;
using testing::sphere_asset;
using testing::sphere_pose;

constexpr SurfacePainter::Wish kMovement{Colouring::kMovement, 3}, kSpeed{Colouring::kSpeed, 3};

/// A source whose poses have three channels more: a scalar, and no velocities.
class PaintedSource : public FakeSource {
 public:
  using FakeSource::FakeSource;
  Truth* truth() const override { return truth_; }
  Truth* truth_ = nullptr;
};

void show(FakeSource& source, SurfaceView& view, ReceivedPose pose) {
  const TimeUs now = pose.arrival_us;
  source.batches.push_back({std::move(pose)});
  view.receive(source, source.poll({}));
  testing::advance(view, source, now);
}

TEST(Paint, MovementIsTheDistanceFromTheRestPose) {
  PaintedSource source(sphere_asset(2));
  SurfaceView view;
  show(source, view, sphere_pose(source.asset_, 1, 1000, 1, 0.25));
  SurfacePainter painter;
  painter.paint(view, source, kMovement);
  ASSERT_EQ(painter.paint().kind, SurfacePaint::Kind::kScalar);
  ASSERT_EQ(painter.paint().values.size(), 162u);
  for (const float value : painter.paint().values) EXPECT_NEAR(value, 0.25, 1e-5);
  EXPECT_NEAR((*painter.range())[1], 0.25, 1e-5);
}

TEST(Paint, SpeedComesFromPosesOrVelocities) {
  PaintedSource source(sphere_asset(2));
  SurfaceView view;
  SurfacePainter painter;
  show(source, view, sphere_pose(source.asset_, 1, 100'000, 1, 0));
  painter.paint(view, source, kSpeed);
  for (const float value : painter.paint().values) EXPECT_EQ(value, 0) << "one pose says nothing";
  show(source, view, sphere_pose(source.asset_, 2, 200'000, 1, 0.5));
  painter.paint(view, source, kSpeed);
  for (const float value : painter.paint().values) EXPECT_NEAR(value, 5, 1e-4);
  painter.paint(view, source, kSpeed);
  EXPECT_NEAR(painter.paint().values.front(), 5, 1e-4) << "asked again it is the same";

  source.info_->format.channels = 6;
  source.info_->format.velocity_channels = 3;
  source.info_->format.velocity_us = 500'000;
  ReceivedPose pose = sphere_pose(source.asset_, 3, 300'000, 1, 0.5);
  pose.channels = 6;
  std::vector<double> wide(36, 0.0);
  for (std::size_t k = 0; k < 6; ++k)
    std::copy_n(pose.coefficients.begin() + 3 * static_cast<long>(k), 3, &wide[6 * k]);
  wide[5] = 2;  // constant column, z: 2 a half second
  pose.coefficients = wide;
  show(source, view, pose);
  painter.paint(view, source, kSpeed);
  for (const float value : painter.paint().values) EXPECT_NEAR(value, 4, 1e-4);
}

TEST(Paint, ScalarChannelsAreRebuiltOrRefused) {
  PaintedSource source(sphere_asset(2));
  source.info_->format.channels = 4;
  SurfaceView view;
  ReceivedPose pose = sphere_pose(source.asset_, 1, 1000, 1);
  pose.channels = 4;
  std::vector<double> wide(24, 0.0);
  for (std::size_t k = 0; k < 6; ++k)
    std::copy_n(pose.coefficients.begin() + 3 * static_cast<long>(k), 3, &wide[4 * k]);
  wide[4 * 1 + 3] = -7;  // the column of x
  pose.coefficients = wide;
  show(source, view, pose);
  SurfacePainter painter;
  painter.paint(view, source, {Colouring::kChannel, 3});
  const auto& values = painter.paint().values;
  ASSERT_EQ(values.size(), 162u);
  for (std::size_t i = 0; i < values.size(); ++i) EXPECT_NEAR(values[i], -7 * view.geometry().positions[3 * i], 1e-4);
  painter.paint(view, source, {Colouring::kChannel, 4});
  EXPECT_EQ(painter.paint().kind, SurfacePaint::Kind::kClay);
  EXPECT_NE(painter.why_not().find("4"), std::string::npos) << "names the channel";
  const auto wishes = wishes_for(source);
  EXPECT_NE(std::find(wishes.begin(), wishes.end(), SurfacePainter::Wish{Colouring::kChannel, 3}), wishes.end());

  source.info_->format.scalars = {{"stress", "MPa", -8, 8, 2}};
  painter.paint(view, source, {Colouring::kChannel, 3, "stress"});
  ASSERT_NE(painter.scalar(), nullptr);
  EXPECT_EQ(painter.scalar()->unit, "MPa");
  EXPECT_EQ(painter.paint().kind, SurfacePaint::Kind::kScalar);
  EXPECT_EQ(title_of(wishes_for(source).back()), "stress");
  painter.paint(view, source, {Colouring::kChannel, 3, "strain"});
  EXPECT_EQ(painter.paint().kind, SurfacePaint::Kind::kClay);
  EXPECT_EQ(painter.scalar(), nullptr);
}

TEST(Paint, FollowsTheLevelOfDetail) {
  PaintedSource source(sphere_asset(3));
  source.asset_.colours.assign(source.asset_.vertex_count, {255, 188, 0});
  SurfaceView view;
  SurfacePainter painter;
  show(source, view, sphere_pose(source.asset_, 1, 1000, 2));
  painter.paint(view, source, {Colouring::kOwn, 3});
  ASSERT_EQ(painter.paint().values.size(), 3u * 642);
  EXPECT_FLOAT_EQ(painter.paint().values[0], 1);
  EXPECT_NEAR(painter.paint().values[1], 0.503, 1e-3) << "linear light of 188";
  const std::uint64_t version = painter.paint().version;
  painter.paint(view, source, {Colouring::kOwn, 3});
  EXPECT_EQ(painter.paint().version, version) << "nothing has changed";
  show(source, view, sphere_pose(source.asset_, 2, 2000, 1));
  painter.paint(view, source, {Colouring::kOwn, 3});
  EXPECT_EQ(painter.paint().version, version) << "colours do not move with the pose";
  view.lod().set_fraction(0.25);
  testing::advance(view, source, 1000);
  painter.paint(view, source, {Colouring::kOwn, 3});
  EXPECT_EQ(painter.paint().values.size(), 3u * view.geometry().vertex_count());
  EXPECT_GT(painter.paint().version, version);
}

TEST(Paint, NewVerticesStartWithTheirParentsColour) {
  PaintedSource source(sphere_asset(2));
  for (std::uint32_t i = 0; i < source.asset_.vertex_count; ++i)
    source.asset_.colours.push_back(i < 42 ? std::array<std::uint8_t, 3>{255, 0, 0}
                                           : std::array<std::uint8_t, 3>{0, 0, 255});
  SurfaceView view;
  SurfacePainter painter;
  view.lod().set_fraction(42.0 / 162);
  show(source, view, sphere_pose(source.asset_, 1, 1000, 1));
  ASSERT_EQ(view.geometry().vertex_count(), 42u);
  view.lod().set_fraction(1);
  testing::advance(view, source, 2000);
  painter.paint(view, source, {Colouring::kOwn, 3});
  ASSERT_EQ(painter.paint().values.size(), 3u * 162);
  EXPECT_LT(painter.paint().values[3 * 161 + 2], 0.05F) << "hardly there";
  for (TimeUs now = 20'000; now < 900'000; now += 20'000) testing::advance(view, source, now);
  painter.paint(view, source, {Colouring::kOwn, 3});
  EXPECT_EQ(painter.paint().values[3 * 161], 0);
  EXPECT_EQ(painter.paint().values[3 * 161 + 2], 1);
}

TEST(Paint, SurfaceWithoutColoursIsClay) {
  PaintedSource source(sphere_asset(2));
  SurfaceView view;
  show(source, view, sphere_pose(source.asset_, 1, 1000, 1));
  SurfacePainter painter;
  painter.paint(view, source, {Colouring::kOwn, 3});
  EXPECT_EQ(painter.paint().kind, SurfacePaint::Kind::kClay);
  EXPECT_FALSE(painter.why_not().empty());
}

class FarOff final : public Truth {
 public:
  bool errors(std::span<const double>, std::uint32_t, std::optional<TimeUs>, std::span<const float>,
              std::span<float> errors) override {
    std::fill(errors.begin(), errors.end(), 0.125F);
    errors[0] = 100;
    return ready;
  }
  std::string why() const override { return "being prepared"; }
  bool ready = false;
};

TEST(Paint, TruthIsAskedUntilItIsReady) {
  PaintedSource source(sphere_asset(2));
  FarOff truth;
  SurfaceView view;
  show(source, view, sphere_pose(source.asset_, 1, 1000, 1));
  SurfacePainter painter;
  painter.paint(view, source, {Colouring::kError, 3});
  EXPECT_NE(painter.why_not().find("--truth"), std::string::npos);
  source.truth_ = &truth;
  painter.paint(view, source, {Colouring::kError, 3});
  EXPECT_EQ(painter.why_not(), "being prepared");
  truth.ready = true;
  painter.paint(view, source, {Colouring::kError, 3});
  EXPECT_EQ(painter.why_not(), "");
  EXPECT_EQ(painter.paint().values.back(), 0.125F);
  EXPECT_EQ(painter.range(), (std::array<float, 2>{0.125F, 0.125F}))
      << "one vertex far off leaves the others their colours";
}

TEST(Legend, SpansRoundNumbersAndNeverShrinks) {
  EXPECT_DOUBLE_EQ(round_up(0.0123), 0.015);
  EXPECT_DOUBLE_EQ(round_up(1), 1);
  EXPECT_DOUBLE_EQ(round_up(8.1), 10);
  EXPECT_DOUBLE_EQ(round_up(350), 400);
  LegendRange range;
  EXPECT_FALSE(range.known());
  range.include({0.1F, 0.33F});
  EXPECT_EQ(range.span(), (std::array<float, 2>{0, 0.4F}));
  range.include({0, 0.1F});
  EXPECT_EQ(range.span(), (std::array<float, 2>{0, 0.4F}));
  range.include({-0.7F, 0.2F});
  EXPECT_EQ(range.span(), (std::array<float, 2>{-0.8F, 0.8F})) << "zero in the middle";
  range.reset();
  range.include({0, 0});
  EXPECT_EQ(range.span(), (std::array<float, 2>{0, 1}));
}

TEST(ColourMaps, LightnessGrowsAsTheValueDoes) {
  for (const ColourMap map : {ColourMap::kViridis, ColourMap::kCividis, ColourMap::kGrey}) {
    const ColourTable table = table_of(map);
    double before = -1;
    for (const auto& c : table) {
      const auto linear = [](std::uint8_t v) { return std::pow(v / 255.0, 2.2); };
      const double light = 0.2126 * linear(c[0]) + 0.7152 * linear(c[1]) + 0.0722 * linear(c[2]);
      EXPECT_GE(light, before - 1e-3) << kColourMapNames[map];
      before = std::max(before, light);
    }
  }
  for (int i = 0; i < kColourMaps; ++i) {
    const auto map = static_cast<ColourMap>(i);
    EXPECT_EQ(kColourMapNames.find(kColourMapNames[map]), map);
  }
  EXPECT_EQ(table_of(ColourMap::kViridis)[255], (std::array<std::uint8_t, 3>{0xFD, 0xE7, 0x25}));
  for (int i = 0; i <= static_cast<int>(Colouring::kError); ++i) {
    const auto colouring = static_cast<Colouring>(i);
    EXPECT_EQ(kColouringNames.find(kColouringNames[colouring]), colouring);
  }
}

}  // namespace
}  // namespace eigencast
