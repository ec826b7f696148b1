// SPDX-License-Identifier: MIT
// What a program sends is what a viewer gets, against a whole broker in this process.
#include "sdk/surface_stream.h"

#include <sys/wait.h>
#include <unistd.h>

#include <cmath>
#include <cstdlib>
#include <limits>
#include <numeric>

#include "common/reconstruction/reconstruct.h"
#include "sdk/subscriber.h"
#include "tests/unit/sdk/ball_stream.h"

namespace eigencast {
namespace {

/// A surface as programs have it.
struct Host {
  std::vector<float> points;
  std::vector<std::uint32_t> corners;

  explicit Host(const Surface& surface) {
    for (const Vec3& v : surface.positions)
      for (const double x : v) points.push_back(static_cast<float>(x));
    for (const Face& f : surface.faces) corners.insert(corners.end(), f.begin(), f.end());
  }
  /// The points, moved along x.
  std::vector<float> at(double shift) const {
    std::vector<float> moved = points;
    for (std::size_t i = 0; i < moved.size(); i += 3) moved[i] += static_cast<float>(shift);
    return moved;
  }
};

SurfaceStream::Frame frame_of(const std::vector<float>& points, const Host& host) {
  SurfaceStream::Frame frame;
  frame.points = points;
  frame.corners = host.corners;
  return frame;
}

SurfaceStreamOptions options_for(const std::string& url) {
  SurfaceStreamOptions options;
  options.publisher.url = url;
  options.bake.rank = 30;
  options.max_rate_hz = std::numeric_limits<double>::infinity();
  return options;
}

std::unique_ptr<SurfaceStream> made(SurfaceStreamOptions options) {
  auto stream = SurfaceStream::create(std::move(options));
  EXPECT_TRUE(stream) << stream.error().message;
  return std::move(*stream);
}

/// The mean of all vertices, of each pose in the order of its coming.
class Watched {
 public:
  explicit Watched(const LoopbackBroker& broker)
      : subscriber_(eigencast::subscribe(broker, {.rate = Profile::Rate::kRaw})) {}
  bool wait_for(std::size_t poses) {
    return eventually([&] {
      for (ReceivedPose& pose : subscriber_->poll(milliseconds(20))) {
        const Asset* asset = subscriber_->asset();
        if (asset == nullptr || !asset->complete() || pose.envelope.epoch != subscriber_->epoch()) continue;
        add(*asset, pose);
      }
      return means.size() >= poses;
    });
  }
  std::vector<std::array<double, 3>> means;
  std::vector<std::size_t> sizes;  ///< Vertices of each.

 private:
  void add(const Asset& asset, const ReceivedPose& pose) {
    Reconstructor reconstructor;
    reconstructor.update(asset);
    std::vector<float> positions(std::size_t{3} * asset.vertex_count);
    PoseToRebuild wish{pose.coefficients, pose.channels, positions, {}};
    reconstructor.rebuild({&wish, 1}, asset.rank, asset.vertex_count);
    std::array<double, 3> mean{};
    for (std::size_t i = 0; i < positions.size(); ++i) mean[i % 3] += positions[i];
    for (std::size_t axis = 0; axis < 3; ++axis) mean[axis] = mean[axis] / asset.vertex_count + asset.origin[axis];
    means.push_back(mean);
    sizes.push_back(asset.vertex_count);
  }
  std::unique_ptr<Subscriber> subscriber_;
};

/// Sends one pose after the other, each once the one before has come.
TEST(SurfaceStream, EveryPoseArrivesInOrder) {
  LoopbackBroker broker;
  const Host ball(make_icosphere(2));
  Watched watched(broker);
  const auto stream = made(options_for(broker.url("live/ball")));
  const auto first = stream->send(frame_of(ball.points, ball));
  ASSERT_TRUE(first) << first.error().message;
  EXPECT_EQ(*first, SurfaceStream::Sent::kBaking);
  ASSERT_TRUE(watched.wait_for(1)) << stream->stats().detail;
  for (int i = 1; i <= 30; ++i) {
    const auto points = ball.at(0.1 * i);
    const auto sent = stream->send(frame_of(points, ball));
    ASSERT_TRUE(sent) << sent.error().message;
    EXPECT_EQ(*sent, SurfaceStream::Sent::kTaken);
    ASSERT_TRUE(watched.wait_for(static_cast<std::size_t>(i) + 1)) << i << stream->stats().detail;
  }
  ASSERT_EQ(watched.means.size(), 31u);
  for (int i = 0; i <= 30; ++i) EXPECT_NEAR(watched.means[static_cast<std::size_t>(i)][0], 0.1 * i, 0.02) << i;
  const auto stats = stream->stats();
  EXPECT_EQ(stats.taken, 31u);
  EXPECT_EQ(stats.frames_sent, 31u);
  EXPECT_EQ(stats.bakes, 1u);
  EXPECT_EQ(stats.early + stats.superseded + stats.dropped, 0u);
}

TEST(SurfaceStream, OfPosesBeforeItIsLiveTheNewestGoesOut) {
  LoopbackBroker broker;
  const std::string url = broker.url("live/ball");
  broker.stop();
  const Host ball(make_icosphere(2));
  const auto stream = made(options_for(url));
  EXPECT_FALSE(stream->wait_live(milliseconds(0))) << "nothing was sent";
  ASSERT_TRUE(stream->send(frame_of(ball.points, ball)));
  ASSERT_TRUE(eventually([&] { return !stream->stats().baking; }));
  const auto live = stream->wait_live(milliseconds(0));
  ASSERT_TRUE(live) << live.error().message;
  EXPECT_FALSE(*live);
  for (const double shift : {1.0, 2.0, 3.0}) {
    const auto points = ball.at(shift);
    const auto sent = stream->send(frame_of(points, ball));
    ASSERT_TRUE(sent);
    EXPECT_EQ(*sent, SurfaceStream::Sent::kDisconnected);
  }
  broker.start();
  Watched watched(broker);
  ASSERT_TRUE(watched.wait_for(1));
  EXPECT_NEAR(watched.means[0][0], 3, 0.02);
  EXPECT_TRUE(*stream->wait_live(milliseconds(0)));
  EXPECT_EQ(stream->stats().superseded, 3u);
  EXPECT_EQ(stream->stats().frames_sent, 1u);
}

TEST(SurfaceStream, AnotherTopologyIsKnownByItsContent) {
  LoopbackBroker broker;
  Host ball(make_icosphere(2));
  Watched watched(broker);
  const auto stream = made(options_for(broker.url("live/ball")));
  ASSERT_TRUE(stream->send(frame_of(ball.points, ball)));
  ASSERT_TRUE(watched.wait_for(1));
  std::vector<std::uint32_t> copy = ball.corners;
  SurfaceStream::Frame same;
  same.points = ball.points;
  same.corners = copy;
  EXPECT_EQ(*stream->send(same), SurfaceStream::Sent::kTaken) << "the same at another address";
  same.corners = {};
  same.as_before = true;
  EXPECT_EQ(*stream->send(same), SurfaceStream::Sent::kTaken);
  std::rotate(ball.corners.begin(), ball.corners.begin() + 3, ball.corners.end());
  EXPECT_EQ(*stream->send(frame_of(ball.points, ball)), SurfaceStream::Sent::kBaking) << "as many, but others";
  ASSERT_TRUE(eventually([&] { return stream->stats().bakes == 2; }));
  const Host larger(make_icosphere(3));
  EXPECT_EQ(*stream->send(frame_of(larger.points, larger)), SurfaceStream::Sent::kBaking);
  ASSERT_TRUE(eventually(
      [&] { return watched.wait_for(1) && watched.wait_for(watched.means.size()) && watched.sizes.back() == 642; }));
  EXPECT_EQ(stream->stats().bakes, 3u);
  same.points = ball.points;
  EXPECT_EQ(stream->send(same).error().code, ErrorCode::kInvalidArgument) << "fewer points, and no faces";
}

TEST(SurfaceStream, PolygonsAxesAndUnitsAreTheStreams) {
  LoopbackBroker broker;
  const auto stream = [&] {
    auto options = options_for(broker.url("live/ball"));
    options.z_up = true;
    options.scale = 0.001;
    options.rebake = false;
    return made(std::move(options));
  }();
  Watched watched(broker);
  std::vector<float> points;
  for (const float z : {5000.0F, 7000.0F})
    for (const auto& [x, y] : {std::pair{1000.0F, 2000.0F}, {3000.0F, 2000.0F}, {3000.0F, 4000.0F}, {1000.0F, 4000.0F}})
      points.insert(points.end(), {x, y, z});
  const std::vector<std::uint32_t> corners{0, 3, 2, 1, 4, 5, 6, 7, 0, 1, 5, 4, 1, 2, 6, 5, 2, 3, 7, 6, 3, 0, 4, 7};
  const std::vector<std::uint64_t> offsets{0, 4, 8, 12, 16, 20, 24};
  SurfaceStream::Frame frame;
  frame.points = points;
  frame.corners = corners;
  frame.offsets = offsets;
  const auto sent = stream->send(frame);
  ASSERT_TRUE(sent) << sent.error().message;
  ASSERT_TRUE(watched.wait_for(1)) << stream->stats().detail;
  EXPECT_NEAR(watched.means[0][0], 2, 0.02);
  EXPECT_NEAR(watched.means[0][1], 6, 0.02) << "z";
  EXPECT_NEAR(watched.means[0][2], -3, 0.02) << "minus y";
  frame.offsets = {};
  EXPECT_EQ(stream->send(frame).error().code, ErrorCode::kInvalidArgument) << "the topology is refused";
}

TEST(SurfaceStream, WhatCannotBeMeantIsRefusedAndTheStreamGoesOn) {
  LoopbackBroker broker;
  const Host ball(make_icosphere(2));
  const auto stream = made(options_for(broker.url("live/ball")));
  Host wrong = ball;
  wrong.corners[0] = 10'000;
  EXPECT_EQ(stream->send(frame_of(wrong.points, wrong)).error().code, ErrorCode::kInvalidArgument);
  auto points = ball.points;
  points[7] = std::nanf("");
  EXPECT_EQ(stream->send(frame_of(points, ball)).error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(stream->stats().taken, 0u);
  ASSERT_TRUE(stream->send(frame_of(ball.points, ball)));
  EXPECT_EQ(stream->send(frame_of(points, ball)).error().code, ErrorCode::kInvalidArgument);
  auto frame = frame_of(ball.points, ball);
  frame.velocities = ball.points;
  EXPECT_EQ(stream->send(frame).error().code, ErrorCode::kInvalidArgument) << "the first pose had none";
  frame.velocities = {};
  frame.scalars = ball.points;
  EXPECT_EQ(stream->send(frame).error().code, ErrorCode::kInvalidArgument);
  ASSERT_TRUE(*stream->wait_live(milliseconds(60'000)));
  EXPECT_TRUE(stream->send(frame_of(ball.points, ball)));
  auto options = options_for("nonsense");
  EXPECT_EQ(SurfaceStream::create(options).error().code, ErrorCode::kInvalidArgument);
  options = options_for(broker.url("live/ball"));
  options.max_rate_hz = 0;
  EXPECT_EQ(SurfaceStream::create(options).error().code, ErrorCode::kInvalidArgument);
}

TEST(SurfaceStream, RangesThatNobodyStatesAreLearntWithoutABake) {
  LoopbackBroker broker;
  const Host ball(make_icosphere(2));
  auto options = options_for(broker.url("live/ball"));
  options.publisher.scalars = {{"pressure"}};
  const auto stream = made(std::move(options));
  const std::vector<float> still(ball.points.size() / 3, 0);
  std::vector<float> pressure(still.size());
  for (std::size_t i = 0; i < pressure.size(); ++i) pressure[i] = 1e5F * ball.points[3 * i];
  auto frame = frame_of(ball.points, ball);
  for (const std::vector<float>& scalars : {still, pressure}) {
    frame.scalars = scalars;
    const auto before = stream->stats().frames_sent;
    ASSERT_TRUE(stream->send(frame));
    ASSERT_TRUE(eventually([&] { return stream->stats().frames_sent > before; })) << stream->stats().detail;
  }
  EXPECT_EQ(stream->stats().bakes, 1u);
  EXPECT_EQ(stream->stats().unusable, 0u);
  pressure[7] = std::numeric_limits<float>::quiet_NaN();
  frame.scalars = pressure;
  const auto bad = stream->send(frame);
  ASSERT_FALSE(bad);
  EXPECT_EQ(bad.error().code, ErrorCode::kInvalidArgument);
}

TEST(SurfaceStream, ItsEndGivesUpABakeAndSendsWhatWaits) {
  LoopbackBroker broker;
  const Host large(make_icosphere(6));
  {
    const auto stream = made(options_for(broker.url("live/ball")));
    ASSERT_TRUE(stream->send(frame_of(large.points, large)));
  }
  const Host ball(make_icosphere(2));
  Watched watched(broker);
  {
    auto options = options_for(broker.url("live/ball"));
    options.max_rate_hz = 25;
    const auto stream = made(std::move(options));
    ASSERT_TRUE(stream->send(frame_of(ball.points, ball)));
    ASSERT_TRUE(watched.wait_for(1));
    for (int i = 1; i <= 9; ++i) {
      const auto points = ball.at(i);
      ASSERT_TRUE(stream->send(frame_of(points, ball)));
    }
  }
  ASSERT_TRUE(eventually([&] { return watched.wait_for(1) && watched.means.back()[0] > 8.9; }))
      << "the last pose stays";
}

TEST(SurfaceStream, AForkedProcessLeavesItAlone) {
  LoopbackBroker broker;
  const Host ball(make_icosphere(2));
  auto stream = made(options_for(broker.url("live/ball")));
  ASSERT_TRUE(stream->send(frame_of(ball.points, ball)));
  ASSERT_TRUE(*stream->wait_live(milliseconds(60'000)));
  const pid_t child = ::fork();
  if (child == 0) {
    const auto sent = stream->send(frame_of(ball.points, ball));
    const bool refused = !sent && sent.error().code == ErrorCode::kUnsupported;
    stream.reset();
    ::_exit(refused ? 0 : 1);
  }
  int status = -1;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0);
  Watched watched(broker);
  const auto points = ball.at(1);
  EXPECT_EQ(*stream->send(frame_of(points, ball)), SurfaceStream::Sent::kTaken);
  EXPECT_TRUE(watched.wait_for(1));
}

}  // namespace
}  // namespace eigencast
