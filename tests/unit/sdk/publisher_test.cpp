// SPDX-License-Identifier: MIT
// What publishers take and refuse, and what rides on positions, against a whole broker in this process.
#include <gtest/gtest.h>

#include <limits>
#include <numbers>

#include "common/wire/limits.h"
#include "sdk/pose_projection.h"
#include "tests/unit/sdk/ball_stream.h"

namespace eigencast {
namespace {

TEST(Publisher, InvalidFramesAreDroppedAndReported) {
  LoopbackBroker broker;
  Sender sender(broker, 40);
  ASSERT_TRUE(sender.send_first());
  auto C = pose(*model(40).asset, 0);
  C[7] = std::nan("");
  EXPECT_EQ(sender.publisher->send_coefficients(C, steady_now_us()), SendStatus::kDropped);
  EXPECT_EQ(sender.publisher->send_coefficients(std::vector<double>(3), steady_now_us()), SendStatus::kDropped);
  EXPECT_EQ(sender.publisher->send_coefficients(pose(*model(40).asset, 0), 1), SendStatus::kDropped)
      << "time must grow";
  const Publisher::Stats stats = sender.publisher->stats();
  EXPECT_EQ(stats.frames_sent, 1u);
  const auto dropped_for = [&stats](Publisher::DropReason why) {
    return stats.dropped_for[static_cast<std::size_t>(why)];
  };
  EXPECT_EQ(dropped_for(Publisher::DropReason::kUnusable), 2u);
  EXPECT_EQ(dropped_for(Publisher::DropReason::kTime), 1u);
  EXPECT_EQ(dropped_for(Publisher::DropReason::kBehind), 0u);
  EXPECT_EQ(stats.frames_dropped, stats.dropped_for[0] + 3) << "and poses before it was live";
  EXPECT_TRUE(sender.send()) << "and the stream goes on";
}

TEST(Publisher, CaptureTimesOutOfRangeAreRefused) {
  LoopbackBroker broker;
  Sender sender(broker, 40);
  ASSERT_TRUE(eventually([&] { return sender.publisher->stats().state == Publisher::State::kLive; }));
  const auto C = pose(*model(40).asset, 0);
  const std::vector<float> positions(std::size_t{642} * 3);
  for (const TimeUs time : {TimeUs{-1}, limits::kMaxTimeUs + 1, std::numeric_limits<TimeUs>::min()}) {
    EXPECT_EQ(sender.publisher->send_coefficients(C, time), SendStatus::kDropped) << time;
    const auto sent = sender.publisher->send_positions(positions, time);
    ASSERT_FALSE(sent) << time;
    EXPECT_EQ(sent.error().code, ErrorCode::kInvalidArgument);
  }
  EXPECT_TRUE(sender.send_first()) << "and the stream goes on";
}

TEST(Publisher, PositionsAreProjectedOnTheBasis) {
  LoopbackBroker broker;
  Sender sender(broker, 40);
  ASSERT_TRUE(sender.send_first());
  std::vector<float> positions;
  for (const Vec3& v : make_icosphere(3).positions)
    for (const double x : v) positions.push_back(static_cast<float>(x));
  const auto status = sender.publisher->send_positions(positions, steady_now_us());
  ASSERT_TRUE(status) << status.error().message;
  EXPECT_EQ(*status, SendStatus::kSent);
  positions.pop_back();
  EXPECT_EQ(sender.publisher->send_positions(positions, steady_now_us()).error().code, ErrorCode::kInvalidArgument);
}

TEST(Publisher, MemoryThatCannotBeIsRefused) {
  LoopbackBroker broker;
  Sender exact(broker, 40);
  const CoefficientLayout layout{CodecKind::kQuantised, 40, 3, model(40).asset->band_ends};
  const auto segment = [&](const CoefficientLayout& of, std::size_t poses) {
    const auto key = key_from_coefficients(of, std::vector<double>(of.size(), 1), 160).value();
    return encode_segment(of, model(40).encoded->manifest.id.digest, std::vector(poses, key), 3).value();
  };
  EXPECT_EQ(exact.publisher->remember({segment(layout, 2)}).error().code, ErrorCode::kInvalidArgument) << "float";
  Sender sender(broker, 40, CodecKind::kQuantised);
  const CoefficientLayout other{CodecKind::kQuantised, 41, 3, {41}};
  EXPECT_EQ(sender.publisher->remember({segment(other, 2)}).error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(sender.publisher->remember({segment(layout, 1000), segment(layout, 25)}).error().code,
            ErrorCode::kTooLarge);
  const std::vector<CodedSegment> many(limits::kMaxMemorySegments + 1, segment(layout, 1));
  EXPECT_EQ(sender.publisher->remember(many).error().code, ErrorCode::kTooLarge);
  ASSERT_TRUE(sender.publisher->remember({segment(layout, 2)}));
  EXPECT_EQ(sender.publisher->remember({segment(layout, 3)}).error().code, ErrorCode::kRefused) << "one is under way";
}

TEST(Publisher, SecondSenderOfAStreamIsRefused) {
  LoopbackBroker broker;
  Sender first(broker, 40);
  ASSERT_TRUE(first.send_first());
  Sender second(broker, 40);
  EXPECT_TRUE(eventually([&] { return second.publisher->stats().state == Publisher::State::kRefused; }))
      << second.publisher->stats().detail;
  EXPECT_FALSE(second.send());
  EXPECT_TRUE(first.send()) << "the first goes on";
}

TEST(Create, InvalidArgumentsAreRefused) {
  const Model& m = model(40);
  for (const char* url : {"nonsense", "ws://127.0.0.1:1", "ws://127.0.0.1:1/a//b", "ws://127.0.0.1:1/.."}) {
    EXPECT_EQ(Subscriber::create({url, {}, {}}).error().code, ErrorCode::kInvalidArgument) << url;
    PublisherOptions options;
    options.url = url;
    EXPECT_EQ(Publisher::create(options, m.asset, m.encoded).error().code, ErrorCode::kInvalidArgument) << url;
  }
  EXPECT_EQ(Subscriber::create({"ws://127.0.0.1:1/a?rate=fast", {}, {}}).error().code, ErrorCode::kInvalidArgument);
  SubscriberOptions secure;
  secure.url = "wss://127.0.0.1:1/a";
  secure.credentials.ca_file = "/nonexistent.pem";
  EXPECT_EQ(Subscriber::create(secure).error().code, ErrorCode::kInvalidArgument);
  PublisherOptions options;
  options.url = "ws://127.0.0.1:1/a";
  options.error = -1;
  EXPECT_EQ(Publisher::create(options, m.asset, m.encoded).error().code, ErrorCode::kInvalidArgument);
}

/// A temperature or a colour rides along: a fourth channel, which the surface is not made of.
TEST(Stream, ScalarsAreRelayedInterpolatedAndDecoded) {
  LoopbackBroker broker;
  const Model& ball = model(40);
  PublisherOptions options;
  options.url = broker.url("live/ball");
  const StreamFormat format{ball.asset->rank, 4, ball.asset->band_ends, "quantised"};
  auto publisher = Publisher::create_for_keys(options, format, ball.encoded);
  ASSERT_TRUE(publisher) << publisher.error().message;
  const CoefficientLayout layout{CodecKind::kQuantised, format.rows, format.channels, format.band_ends};
  const std::uint8_t step = step_index_below(1e-4);
  std::map<TimeUs, std::vector<double>> sent;
  const auto send = [&] {
    std::vector<double> C(layout.size());
    for (std::size_t row = 0; row < layout.rows; ++row) {
      for (std::size_t axis = 0; axis < 3; ++axis) C[row * 4 + axis] = ball.asset->rest[row * 3 + axis];
      C[row * 4 + 3] = std::sin(0.3 * static_cast<double>(sent.size()) + static_cast<double>(row));
    }
    const TimeUs now = steady_now_us();
    Key key = *key_from_coefficients(layout, C, step);
    C = coefficients_from_key(layout, key);
    if ((*publisher)->send_key(std::move(key), now) == SendStatus::kSent) sent[now] = std::move(C);
    return !sent.empty();
  };
  ASSERT_TRUE(eventually(send));
  const auto raw = subscribe(broker), tripled = subscribe(broker, {.rate = Profile::Rate::kInterpolated, .k = 3});
  int keys = 0, between = 0;
  const auto compare = [&](const ReceivedPose& p, const std::vector<double>& expected, double tolerance) {
    EXPECT_EQ(p.channels, 4u);
    ASSERT_EQ(p.coefficients.size(), expected.size());
    for (std::size_t i = 0; i < expected.size(); ++i) ASSERT_NEAR(p.coefficients[i], expected[i], tolerance) << i;
  };
  eventually([&] {
    send();
    for (const ReceivedPose& p : raw->poll(milliseconds(10))) {
      compare(p, sent.at(p.envelope.capture_us), 0);
      ++keys;
    }
    for (const ReceivedPose& p : tripled->poll(milliseconds(10))) {
      const auto after = sent.upper_bound(p.envelope.capture_us);
      if (p.envelope.step.at == p.envelope.step.of || after == sent.end() || after == sent.begin()) continue;
      const double u = double(p.envelope.step.at) / p.envelope.step.of;
      compare(p, straight_between(std::prev(after)->second, after->second, u), 0.5001 * step_size(step));
      ++between;
    }
    return keys >= 20 && between >= 20;
  });
  EXPECT_GE(keys, 20);
  EXPECT_GE(between, 20);
}

TEST(Stream, VelocitiesBendTheInterpolation) {
  // One coefficient swings; keys are 40 ms apart, a tenth of its turn. Between them a straight line cuts the corner.
  LoopbackBroker broker;
  const Model& ball = model(40);
  PublisherOptions options;
  options.url = broker.url("live/ball");
  options.error = 1e-4 * ball.asset->diagonal();
  options.key_rate_hz = 25;
  options.velocities = true;
  auto publisher = Publisher::create(options, ball.asset, ball.encoded);
  ASSERT_TRUE(publisher);
  const double turns_per_us = 2.5e-6 * 2 * std::numbers::pi, wide = 0.3;
  const std::size_t moving = 12 * 3;
  const TimeUs zero = steady_now_us();
  int keys = 0;
  const auto send = [&] {
    const TimeUs at = zero + keys * 40'000;
    std::vector<double> C = ball.asset->rest, V(C.size(), 0.0);
    const double phase = turns_per_us * static_cast<double>(at - zero);
    C[moving] += wide * std::sin(phase);
    V[moving] = wide * turns_per_us * 1e6 * std::cos(phase);
    if ((*publisher)->send_coefficients(C, at, V) == SendStatus::kSent) ++keys;
  };
  Profile profile;
  profile.scheme = Profile::Scheme::kHermite;
  auto subscriber = subscribe(broker, profile);
  double worst = 0;
  int between = 0;
  eventually([&] {
    if (steady_now_us() >= zero + keys * 40'000) send();
    for (const ReceivedPose& p : subscriber->poll(milliseconds(2))) {
      EXPECT_EQ(p.channels, 6U);
      if (p.envelope.step.at == p.envelope.step.of) continue;
      ++between;
      const double truth =
          ball.asset->rest[moving] + wide * std::sin(turns_per_us * static_cast<double>(p.envelope.capture_us - zero));
      worst = std::max(worst, std::abs(p.coefficients[moving / 3 * 6] - truth));
    }
    return between >= 30;
  });
  ASSERT_GE(between, 30);
  ASSERT_TRUE(subscriber->info());
  EXPECT_EQ(subscriber->info()->profile.scheme, Profile::Scheme::kHermite) << "not given as linear";
  EXPECT_EQ(subscriber->info()->format.velocity_channels, 3U);
  // A straight line would be off by up to (2 pi / 10)^2 / 8 = 4.9 % of the swing; the cubic by (2 pi / 10)^4 / 384 =
  // 0.04 %.
  EXPECT_LT(worst, 0.006 * wide);

  const std::vector<float> still(3 * ball.asset->vertex_count);
  EXPECT_EQ((*publisher)->send_positions(still, steady_now_us()).error().code, ErrorCode::kInvalidArgument)
      << "velocities were announced";
  EXPECT_EQ((*publisher)->as_received().size(), ball.asset->rest.size());
}

TEST(Stream, EachScalarHasAnErrorOfItsOwn) {
  LoopbackBroker broker;
  const Model& ball = model(40);
  PublisherOptions options;
  options.url = broker.url("live/ball");
  options.scalars = {{"pressure", "Pa", 0, 1e6}, {"strain", "", 0, 1e-3}, {"T", "K", 250, 350, 0.5}};
  auto publisher = Publisher::create(options, ball.asset, ball.encoded);
  ASSERT_TRUE(publisher) << publisher.error().message;
  const std::array<double, 3> bounds{1e3, 1e-6, 0.5};
  std::vector<float> positions, scalars;
  for (const Vec3& v : make_icosphere(3).positions) {
    for (const double x : v) positions.push_back(static_cast<float>(x));
    for (const double x : {5e5 + 4e5 * v[0], 5e-4 + 4e-4 * v[1], 300 + 40 * v[2]})
      scalars.push_back(static_cast<float>(x));
  }
  const std::vector<double> S = Projector::create(*ball.asset)->coefficients_from_vectors(scalars).value();
  const auto subscriber = subscribe(broker, {.rate = Profile::Rate::kRaw});
  int poses = 0;
  ASSERT_TRUE(eventually([&] {
    EXPECT_TRUE((*publisher)->send_pose({positions, {}, scalars}, steady_now_us()));
    for (const ReceivedPose& pose : subscriber->poll(milliseconds(20))) {
      ++poses;
      EXPECT_EQ(pose.channels, 6U);
      for (std::size_t k = 0; k < 3; ++k) {
        double square = 0;
        for (std::size_t row = 0; row < ball.asset->rank; ++row) {
          const double off = pose.coefficients[6 * row + 3 + k] - S[3 * row + k];
          square += off * off;
        }
        EXPECT_LT(std::sqrt(square / ball.asset->area), bounds[k]) << options.scalars[k].name;
      }
    }
    return poses >= 5;
  }));
  ASSERT_EQ(subscriber->info()->format.scalars.size(), 3U);
  EXPECT_EQ(subscriber->info()->format.scalars[0].unit, "Pa");
  EXPECT_EQ(subscriber->info()->format.scalars[2].high, 350);
  // A tenth of the error is asked for by a tenfold scale.
  options.scalars[2].error = 0.05;
  const StreamFormat finer = format_of(options, *ball.asset);
  EXPECT_NEAR(finer.scalars[2].scale, 10 * subscriber->info()->format.scalars[2].scale, 1e-9);
  options.scalars[0].name = "T";
  EXPECT_EQ(Publisher::create(options, ball.asset, ball.encoded).error().code, ErrorCode::kInvalidArgument);
}

}  // namespace
}  // namespace eigencast
