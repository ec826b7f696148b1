// SPDX-License-Identifier: MIT
// Publisher and subscriber against a whole broker in this process.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <limits>
#include <map>
#include <mutex>
#include <numbers>
#include <stdexcept>

#include "common/codec/chain.h"
#include "common/surface/shapes.h"
#include "common/wire/control.h"
#include "common/wire/limits.h"
#include "sdk/bake.h"
#include "sdk/publisher.h"
#include "sdk/subscriber.h"
#include "tests/support/loopback_broker.h"

namespace eigencast {
namespace {

using testing::eventually;
using ::testing::HasSubstr;
using testing::LoopbackBroker;
using testing::milliseconds;
using testing::TemporaryFolder;

struct Model {
  std::shared_ptr<const Asset> asset;
  std::shared_ptr<const EncodedAsset> encoded;
};

/// An icosphere of 642 vertices; each rank is another asset.
const Model& model(int rank) {
  static std::map<int, Model> models;
  Model& m = models[rank];
  if (!m.asset) {
    auto baked = bake(make_icosphere(3), {.basis = "augmented", .rank = rank, .name = "ball"});
    EXPECT_TRUE(baked) << baked.error().message;
    m = {std::make_shared<const Asset>(std::move(baked->asset)),
         std::make_shared<const EncodedAsset>(std::move(baked->encoded))};
  }
  return m;
}

/// Pose i: the rest pose, wobbling.
std::vector<double> pose(const Asset& asset, int i) {
  std::vector<double> C = asset.rest;
  for (std::size_t j = 12; j < C.size(); ++j) C[j] += 0.05 * std::sin(0.1 * i + static_cast<double>(j));
  return C;
}

/// Eq. 7 of the paper.
std::vector<double> straight_between(const std::vector<double>& a, const std::vector<double>& b, double u) {
  std::vector<double> result(a.size());
  for (std::size_t i = 0; i < a.size(); ++i) result[i] = a[i] + u * (b[i] - a[i]);
  return result;
}

/// Sends pose after pose, whenever it is asked to.
class Sender {
 public:
  Sender(const LoopbackBroker& broker, int rank, CodecKind codec = CodecKind::kFloat64) : model_(model(rank)) {
    PublisherOptions options;
    options.url = broker.url("live/ball");
    options.codec = codec;
    auto made = Publisher::create(std::move(options), model_.asset, model_.encoded);
    EXPECT_TRUE(made) << made.error().message;
    publisher = std::move(*made);
  }
  /// Sends the next pose; true if it left. Capture times are real: the broker's pacing follows them.
  bool send() {
    const TimeUs now = steady_now_us();
    if (now <= last_us_) return false;
    const auto C = pose(*model_.asset, count_);
    if (publisher->send_coefficients(C, now) != SendStatus::kSent) return false;
    last_us_ = now;
    ++count_;
    sent[now] = C;
    received[now] = publisher->as_received();
    return true;
  }
  bool send_first() {
    return eventually([&] { return send(); });
  }
  std::unique_ptr<Publisher> publisher;
  std::map<TimeUs, std::vector<double>> sent;
  std::map<TimeUs, std::vector<double>> received;  ///< What the publisher says that receivers decode.

 private:
  Model model_;
  int count_ = 0;
  TimeUs last_us_ = 0;
};

std::unique_ptr<Subscriber> subscribe(const LoopbackBroker& broker, Profile profile = {.rate = Profile::Rate::kRaw},
                                      std::string cache = {}) {
  auto made = Subscriber::create({broker.url("live/ball"), profile, std::move(cache)});
  EXPECT_TRUE(made) << made.error().message;
  return std::move(*made);
}

/// Sends a pose every few milliseconds and polls until `enough` poses came.
std::vector<ReceivedPose> exchange(Sender& sender, Subscriber& subscriber, std::size_t enough,
                                   milliseconds gap = milliseconds(8)) {
  std::vector<ReceivedPose> all;
  eventually([&] {
    (void)sender.send();
    const auto until = std::chrono::steady_clock::now() + gap;
    do {
      for (ReceivedPose& p : subscriber.poll(milliseconds(2))) all.push_back(std::move(p));
    } while (std::chrono::steady_clock::now() < until);
    return all.size() >= enough;
  });
  return all;
}

/// A sender that announces whatever it is told to, of an asset that the broker has.
class RawSender {
 public:
  explicit RawSender(const LoopbackBroker& broker) {
    WebSocketOptions options;
    options.url = *parse_broker_url(broker.url("live/ball"));
    options.target = "/v1/publish/live/ball";
    options.first_retry = milliseconds(20);
    options.longest_retry = milliseconds(100);
    WebSocketEvents events;
    events.on_text = [this](std::string_view text) {
      const auto message = control_from_text(text);
      const std::lock_guard lock(mutex_);
      if (message && std::holds_alternative<control::Announced>(*message))
        announced_ = std::get<control::Announced>(*message);
    };
    socket_ = std::make_unique<WebSocket>(std::move(options), std::move(events));
  }
  ~RawSender() { socket_->stop(); }

  /// True once the broker has accepted float64 poses of so many channels.
  bool announce(const Model& model, std::uint32_t channels) {
    layout_ = {CodecKind::kFloat64, model.asset->rank, channels, model.asset->band_ends};
    control::Announce m;
    m.asset = model.encoded->manifest.id.hex();
    m.format = {layout_.rows, channels, layout_.band_ends, "float64"};
    const std::uint32_t before = epoch();
    return eventually([&] { return socket_->send_text(text_from_control(m)) == SendStatus::kSent; }) &&
           eventually([&] { return epoch() > before; });
  }
  /// Sends a join of the lowest band alone: zeros.
  void send_lowest_band() {
    const std::vector<double> C(std::size_t{layout_.rows} * layout_.channels);
    auto key = key_from_coefficients(layout_, C, 0);
    ASSERT_TRUE(key);
    key->bands = 1;
    const auto payload = encode_join(layout_, advanced({}, *key, 0));
    ASSERT_TRUE(payload) << payload.error().message;
    Envelope e;
    e.kind = FrameKind::kJoin;
    e.bands = 1;
    e.sequence = ++sequence_;
    e.capture_us = steady_now_us();
    Bytes frame;
    append_envelope(e, frame);
    frame.insert(frame.end(), payload->begin(), payload->end());
    (void)socket_->send_binary(std::move(frame));
  }
  std::uint32_t epoch() {
    const std::lock_guard lock(mutex_);
    return announced_.epoch;
  }

 private:
  std::mutex mutex_;
  control::Announced announced_;
  CoefficientLayout layout_;
  std::uint64_t sequence_ = 0;
  std::unique_ptr<WebSocket> socket_;
};

/// Sends lowest bands and polls until a pose of the present epoch came; all poses that came.
std::vector<ReceivedPose> exchange_lowest(RawSender& sender, Subscriber& subscriber, milliseconds most) {
  std::vector<ReceivedPose> all;
  eventually(
      [&] {
        sender.send_lowest_band();
        for (ReceivedPose& p : subscriber.poll(milliseconds(10))) all.push_back(std::move(p));
        return !all.empty() && all.back().envelope.epoch == sender.epoch();
      },
      most);
  return all;
}

TEST(Stream, TheSameSurfaceWithPosesThatCannotDeformItIsRefusedUntilTheyCan) {
  LoopbackBroker broker;
  const Model& m = model(40);
  {
    Sender uploads(broker, 40);
    ASSERT_TRUE(uploads.send_first());
  }
  RawSender sender(broker);
  ASSERT_TRUE(sender.announce(m, 3));
  const auto subscriber = subscribe(broker);
  ASSERT_FALSE(exchange_lowest(sender, *subscriber, milliseconds(20000)).empty()) << subscriber->stats().detail;
  const std::uint32_t good = subscriber->epoch();

  // Rows that do not come are filled in from the rest pose's three channels: there is no room for them in one.
  ASSERT_TRUE(sender.announce(m, 1));
  for (const auto& p : exchange_lowest(sender, *subscriber, milliseconds(500))) EXPECT_EQ(p.envelope.epoch, good);
  EXPECT_EQ(subscriber->stats().state, Subscriber::State::kRefused);
  EXPECT_THAT(subscriber->stats().detail, HasSubstr("channels"));

  ASSERT_TRUE(sender.announce(m, 4));
  const auto poses = exchange_lowest(sender, *subscriber, milliseconds(20000));
  ASSERT_FALSE(poses.empty()) << subscriber->stats().detail;
  EXPECT_EQ(subscriber->stats().state, Subscriber::State::kLive) << subscriber->stats().detail;
  const auto& C = poses.back().coefficients;
  ASSERT_EQ(C.size(), 160u);
  for (std::size_t i = 0; i < 160; ++i) {
    const bool rest = i / 4 >= m.asset->band_ends[0] && i % 4 < 3;
    EXPECT_EQ(C[i], rest ? m.asset->rest[i / 4 * 3 + i % 4] : 0);
  }
}

TEST(Stream, RawFloat64DeliversExactlyWhatWasSentInOrder) {
  LoopbackBroker broker;
  Sender sender(broker, 40);
  ASSERT_TRUE(sender.send_first()) << sender.publisher->stats().detail;
  const auto subscriber = subscribe(broker);
  const auto poses = exchange(sender, *subscriber, 30);
  ASSERT_GE(poses.size(), 30u) << subscriber->stats().detail;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    ASSERT_TRUE(sender.sent.contains(poses[i].envelope.capture_us));
    EXPECT_EQ(poses[i].coefficients, sender.sent[poses[i].envelope.capture_us]);
    if (i > 0) {
      EXPECT_GT(poses[i].envelope.sequence, poses[i - 1].envelope.sequence);
    }
  }
  ASSERT_TRUE(eventually([&] { return (void)subscriber->poll(milliseconds(5)), subscriber->asset()->complete(); }));
  EXPECT_EQ(subscriber->asset()->rest, model(40).asset->rest);
  EXPECT_EQ(subscriber->asset()->basis, model(40).asset->basis);
  const auto stats = subscriber->stats();
  EXPECT_EQ(stats.state, Subscriber::State::kLive);
  EXPECT_EQ(stats.missed, 0u);
  EXPECT_EQ(stats.asset_bytes_downloaded, stats.asset_bytes_total);
  EXPECT_EQ(stats.latency_us.negative(), 0u) << "one clock: nothing arrives before it was captured";
  EXPECT_EQ(sender.publisher->stats().subscribers, 1u);
  EXPECT_TRUE(eventually([&] { return subscriber->stats().clock_offset_us.has_value(); }));
  EXPECT_LE(std::abs(*subscriber->stats().clock_offset_us), *subscriber->stats().clock_error_us) << "one clock";
}

TEST(Stream, QuantisedDeliversWhatThePublisherSaysItWill) {
  LoopbackBroker broker;
  Sender sender(broker, 40, CodecKind::kQuantised);
  ASSERT_TRUE(sender.send_first());
  const auto subscriber = subscribe(broker);
  for (const auto& p : exchange(sender, *subscriber, 10)) {
    EXPECT_EQ(p.coefficients, sender.received.at(p.envelope.capture_us));
  }
}

class Forms : public ::testing::TestWithParam<Profile::Form> {};

TEST_P(Forms, InterpolatedPosesAreEquation7OfTheirNeighbours) {
  LoopbackBroker broker;
  Sender sender(broker, 40);
  ASSERT_TRUE(sender.send_first());
  const auto subscriber = subscribe(broker, {Profile::Rate::kInterpolated, 3, GetParam(), 8});
  std::size_t checked = 0;
  for (const auto& p : exchange(sender, *subscriber, 90, milliseconds(20))) {
    if (p.envelope.step.at == p.envelope.step.of) {
      EXPECT_TRUE(sender.sent.contains(p.envelope.capture_us));
      continue;
    }
    const auto after = sender.sent.upper_bound(p.envelope.capture_us);
    ASSERT_NE(after, sender.sent.end());
    ASSERT_NE(after, sender.sent.begin());
    const auto expected =
        straight_between(std::prev(after)->second, after->second, double(p.envelope.step.at) / p.envelope.step.of);
    for (std::size_t i = 0; i < expected.size(); ++i) ASSERT_NEAR(p.coefficients[i], expected[i], 1e-12);
    ++checked;
  }
  EXPECT_GT(checked, 20u);
  EXPECT_GT(subscriber->stats().synthetic, 20u);
}

INSTANTIATE_TEST_SUITE_P(FullAndCompact, Forms, ::testing::Values(Profile::Form::kFull, Profile::Form::kCompact));

TEST(Stream, BandsThatDoNotComeReadAsTheRestPose) {
  LoopbackBroker broker;
  Sender sender(broker, 40);
  ASSERT_TRUE(sender.send_first());
  const auto subscriber = subscribe(broker, {.rate = Profile::Rate::kRaw, .bands = 1});
  const auto poses = exchange(sender, *subscriber, 5);
  ASSERT_GE(poses.size(), 5u);
  const std::size_t end = model(40).asset->band_ends[0] * 3;
  for (const auto& p : poses) {
    const auto& truth = sender.sent.at(p.envelope.capture_us);
    for (std::size_t i = 0; i < end; ++i) EXPECT_EQ(p.coefficients[i], truth[i]);
    for (std::size_t i = end; i < truth.size(); ++i) EXPECT_EQ(p.coefficients[i], model(40).asset->rest[i]);
  }
}

TEST(Stream, ABrokerThatLostEverythingIsGivenEverythingAgain) {
  LoopbackBroker broker;
  Sender sender(broker, 40);
  ASSERT_TRUE(sender.send_first());
  const auto subscriber = subscribe(broker);
  ASSERT_GE(exchange(sender, *subscriber, 5).size(), 5u);
  const std::uint32_t epoch = subscriber->epoch();
  const std::uint64_t downloaded = subscriber->stats().asset_bytes_downloaded;
  broker.stop();
  ASSERT_TRUE(eventually([&] {
    (void)subscriber->poll(milliseconds(5));
    return subscriber->stats().state == Subscriber::State::kLost &&
           sender.publisher->stats().state != Publisher::State::kLive;
  }));
  EXPECT_THAT(subscriber->stats().detail, HasSubstr("next try in"));
  EXPECT_THAT(sender.publisher->stats().detail, HasSubstr("next try in"));
  EXPECT_FALSE(sender.send()) << "dropped, not queued";
  EXPECT_NE(subscriber->asset(), nullptr) << "what was there is kept";
  broker.forget_assets();
  broker.start();
  const auto poses = exchange(sender, *subscriber, 5);
  ASSERT_GE(poses.size(), 5u) << sender.publisher->stats().detail << " / " << subscriber->stats().detail;
  EXPECT_GT(subscriber->epoch(), epoch);
  EXPECT_EQ(poses.back().envelope.epoch, subscriber->epoch());
  EXPECT_EQ(poses.back().coefficients, sender.sent.at(poses.back().envelope.capture_us));
  EXPECT_EQ(subscriber->stats().asset_bytes_downloaded, downloaded) << "the same surface is not downloaded twice";
  EXPECT_GE(subscriber->stats().reconnects, 1u);
  EXPECT_GE(sender.publisher->stats().reconnects, 1u);
}

TEST(Stream, ASecondSubscriberReadsTheSurfaceFromTheCache) {
  LoopbackBroker broker;
  TemporaryFolder cache;
  Sender sender(broker, 40);
  ASSERT_TRUE(sender.send_first());
  std::uint64_t total = 0;
  {
    const auto first = subscribe(broker, {.rate = Profile::Rate::kRaw}, cache.file("c"));
    ASSERT_TRUE(
        eventually([&] { return (void)first->poll(milliseconds(5)), first->asset() && first->asset()->complete(); }));
    total = first->stats().asset_bytes_total;
    EXPECT_EQ(first->stats().asset_bytes_downloaded, total);
  }
  const auto second = subscribe(broker, {.rate = Profile::Rate::kRaw}, cache.file("c"));
  ASSERT_TRUE(
      eventually([&] { return (void)second->poll(milliseconds(5)), second->asset() && second->asset()->complete(); }));
  EXPECT_EQ(second->stats().asset_bytes_downloaded, 0u);
  EXPECT_EQ(second->stats().asset_bytes_cached, total);
}

TEST(Stream, ALogThatThrowsWhileDownloadingEndsNothing) {
  LoopbackBroker broker;
  TemporaryFolder folder;
  const std::string no_folder = folder.file("file");
  std::ofstream(no_folder) << "here no cache can be";
  Sender sender(broker, 40);
  ASSERT_TRUE(sender.send_first());
  const LogSink sink = [](LogLevel, std::string_view text) {
    if (text.find("not kept in the cache") != std::string_view::npos) throw std::runtime_error("disk full");
  };
  auto made = Subscriber::create({broker.url("live/ball"), {}, no_folder}, sink);
  ASSERT_TRUE(made);
  EXPECT_TRUE(eventually([&] {
    (void)(*made)->poll(milliseconds(5));
    return (*made)->stats().detail.find("disk full; next try in") != std::string::npos;
  })) << (*made)->stats().detail;
}

TEST(Stream, AnotherSurfaceReplacesTheOldOneOnceItCanBeDrawn) {
  LoopbackBroker broker;
  const auto subscriber = subscribe(broker);
  ASSERT_TRUE(eventually([&] {
    return (void)subscriber->poll(milliseconds(5)), subscriber->stats().state == Subscriber::State::kWaiting;
  }));
  {
    Sender sender(broker, 40);
    ASSERT_TRUE(sender.send_first());
    ASSERT_GE(exchange(sender, *subscriber, 5).size(), 5u);
    EXPECT_EQ(subscriber->asset()->rank, 40u);
  }
  ASSERT_TRUE(eventually([&] {
    return (void)subscriber->poll(milliseconds(5)), subscriber->stats().state == Subscriber::State::kStalled;
  }));
  EXPECT_THAT(subscriber->stats().detail, HasSubstr("stalled"));
  EXPECT_EQ(subscriber->asset()->rank, 40u) << "the last pose is held";
  Sender other(broker, 24);
  ASSERT_TRUE(other.send_first());
  for (int i = 0; i < 10; ++i) {
    for (const auto& p : exchange(other, *subscriber, 1)) {
      EXPECT_EQ(p.envelope.epoch, subscriber->epoch()) << "poses come with the surface that they deform";
      EXPECT_EQ(p.coefficients.size(), subscriber->asset()->rank * 3u);
    }
  }
  EXPECT_EQ(subscriber->asset()->rank, 24u);
}

TEST(Publisher, AFrameThatCannotBeMeantIsDroppedAndSaid) {
  LoopbackBroker broker;
  Sender sender(broker, 40);
  ASSERT_TRUE(sender.send_first());
  auto C = pose(*model(40).asset, 0);
  C[7] = std::nan("");
  EXPECT_EQ(sender.publisher->send_coefficients(C, steady_now_us()), SendStatus::kDropped);
  EXPECT_EQ(sender.publisher->send_coefficients(std::vector<double>(3), steady_now_us()), SendStatus::kDropped);
  EXPECT_EQ(sender.publisher->send_coefficients(pose(*model(40).asset, 0), 1), SendStatus::kDropped)
      << "time must grow";
  EXPECT_EQ(sender.publisher->stats().frames_sent, 1u);
  EXPECT_TRUE(sender.send()) << "and the stream goes on";
}

TEST(Publisher, ATimeThatNoFrameCanCarryIsRefused) {
  LoopbackBroker broker;
  Sender sender(broker, 40);
  ASSERT_TRUE(eventually([&] { return sender.publisher->stats().state == Publisher::State::kLive; }));
  const auto C = pose(*model(40).asset, 0);
  const std::vector<float> positions(std::size_t{642} * 3);
  for (const TimeUs time : {TimeUs{-1}, limits::kMaxTimeUs + 1, std::numeric_limits<TimeUs>::min()}) {
    EXPECT_EQ(sender.publisher->send_coefficients(C, time), SendStatus::kDropped) << time;
    EXPECT_THAT(sender.publisher->stats().detail, HasSubstr("capture time"));
    const auto sent = sender.publisher->send_positions(positions, time);
    ASSERT_FALSE(sent) << time;
    EXPECT_EQ(sent.error().code, ErrorCode::kInvalidArgument);
  }
  EXPECT_TRUE(sender.send_first()) << "and the stream goes on";
}

TEST(Publisher, SendsPositionsThroughTheBasis) {
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

TEST(Publisher, ASecondSenderOfTheSameStreamIsRefusedAndSaysSo) {
  LoopbackBroker broker;
  Sender first(broker, 40);
  ASSERT_TRUE(first.send_first());
  Sender second(broker, 40);
  EXPECT_TRUE(eventually([&] { return second.publisher->stats().state == Publisher::State::kRefused; }))
      << second.publisher->stats().detail;
  EXPECT_FALSE(second.send());
  EXPECT_TRUE(first.send()) << "the first goes on";
}

TEST(Create, RefusesWhatCannotBeMeant) {
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
TEST(Stream, ValuesBesideXYZAreRelayedInterpolatedAndDecoded) {
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
      if (p.envelope.kind != FrameKind::kSynthetic || after == sent.end() || after == sent.begin()) continue;
      const double u = double(p.envelope.step.at) / p.envelope.step.of;
      // Made poses are coded without a spacing where keys are: what rounding to steps leaves.
      compare(p, straight_between(std::prev(after)->second, after->second, u), step_size(step));
      ++between;
    }
    return keys >= 20 && between >= 20;
  });
  EXPECT_GE(keys, 20);
  EXPECT_GE(between, 20);
}

TEST(Stream, VelocitiesBendTheWayBetweenKeys) {
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
    if ((*publisher)->send_coefficients(C, V, at) == SendStatus::kSent) ++keys;
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
      if (p.envelope.kind != FrameKind::kSynthetic) continue;
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
  // A straight line would be off by up to (2 pi / 10)^2 / 8 = 4.9 % of the swing; the cubic by (2 pi / 10)^4 / 384 = 0.04 %.
  EXPECT_LT(worst, 0.006 * wide);

  const std::vector<float> still(3 * ball.asset->vertex_count);
  EXPECT_EQ((*publisher)->send_positions(still, steady_now_us()).error().code, ErrorCode::kInvalidArgument)
      << "velocities were announced";
  EXPECT_EQ((*publisher)->as_received().size(), ball.asset->rest.size());
}

}  // namespace
}  // namespace eigencast
