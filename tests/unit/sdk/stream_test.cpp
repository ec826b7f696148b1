// SPDX-License-Identifier: MIT
// Publisher and subscriber against a whole broker in this process.
#include <gtest/gtest.h>

#include <fstream>
#include <mutex>
#include <stdexcept>

#include "common/asset/format/reader.h"
#include "common/codec/chain.h"
#include "common/wire/control.h"
#include "tests/unit/sdk/ball_stream.h"

namespace eigencast {
namespace {

using testing::TemporaryFolder;

/// A sender that announces whatever it is given, of an asset that the broker has.
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
    socket_ = WebSocket::start(std::move(options), std::move(events));
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
    e.tag = tag();
    Bytes frame;
    append_envelope(e, nullptr, frame);
    frame.insert(frame.end(), payload->begin(), payload->end());
    (void)socket_->send_binary(std::move(frame));
  }
  std::uint8_t tag() {
    const std::lock_guard lock(mutex_);
    return announced_.tag;
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

TEST(Stream, SurfaceOverTheBudgetIsRefused) {
  LoopbackBroker broker;
  Sender sender(broker, 40);
  ASSERT_TRUE(sender.send_first());
  const auto& encoded = *model(40).encoded;
  const auto reader = AssetReader::from_manifest(encoded.manifest.id, encoded.manifest.bytes);
  ASSERT_TRUE(reader);
  const std::uint64_t needed = reader->memory_bytes();
  MemoryBudget memory(2 * needed - 1);
  const auto watch = [&] {
    SubscriberOptions options;
    options.url = broker.url("live/ball");
    options.memory = &memory;
    auto made = Subscriber::create(std::move(options));
    EXPECT_TRUE(made) << made.error().message;
    return std::move(*made);
  };
  const auto reaches = [](Subscriber& subscriber, Subscriber::State state) {
    return eventually([&] { return (void)subscriber.poll(milliseconds(10)), subscriber.stats().state == state; });
  };
  auto first = watch();
  ASSERT_TRUE(reaches(*first, Subscriber::State::kLive)) << first->stats().detail;
  EXPECT_EQ(memory.remaining(), needed - 1);
  // All that share the budget count.
  const auto second = watch();
  EXPECT_TRUE(reaches(*second, Subscriber::State::kRefused)) << second->stats().detail;
  EXPECT_EQ(second->asset(), nullptr);
  first.reset();
  EXPECT_EQ(memory.remaining(), 2 * needed - 1);
  const auto third = watch();
  EXPECT_TRUE(reaches(*third, Subscriber::State::kLive)) << third->stats().detail;
}

TEST(Stream, PosesOfAnotherFormatRefuseTheStream) {
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

TEST(Stream, RawFloat64IsDeliveredExactlyAndInOrder) {
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
  EXPECT_EQ(subscriber->asset()->floats, model(40).asset->floats);
  EXPECT_EQ(subscriber->asset()->integers, model(40).asset->integers);
  const auto stats = subscriber->stats();
  EXPECT_EQ(stats.state, Subscriber::State::kLive);
  EXPECT_EQ(stats.missed, 0u);
  EXPECT_EQ(stats.asset_bytes_downloaded, stats.asset_bytes_total);
  EXPECT_EQ(stats.latency_us.negative(), 0u) << "one clock: nothing arrives before it was captured";
  EXPECT_EQ(sender.publisher->stats().subscribers, 1u);
  EXPECT_TRUE(eventually([&] { return subscriber->stats().clock_offset_us.has_value(); }));
  EXPECT_LE(std::abs(*subscriber->stats().clock_offset_us), *subscriber->stats().clock_error_us) << "one clock";
}

TEST(Stream, QuantisedPosesEqualThePublishersPrediction) {
  LoopbackBroker broker;
  Sender sender(broker, 40, CodecKind::kQuantised);
  ASSERT_TRUE(sender.send_first());
  const auto subscriber = subscribe(broker);
  for (const auto& p : exchange(sender, *subscriber, 10)) {
    EXPECT_EQ(p.coefficients, sender.received.at(p.envelope.capture_us));
  }
}

TEST(Stream, InterpolatedPosesFollowEquation7) {
  LoopbackBroker broker;
  Sender sender(broker, 40);
  ASSERT_TRUE(sender.send_first());
  const auto subscriber = subscribe(broker, {Profile::Rate::kInterpolated, 3});
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

TEST(Stream, AbsentBandsReadAsTheRestPose) {
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

TEST(Stream, BrokerWithoutStateIsRestored) {
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

TEST(Stream, SecondSubscriberReadsFromTheCache) {
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

TEST(Stream, ThrowingLogDoesNotEndTheDownload) {
  LoopbackBroker broker;
  TemporaryFolder folder;
  const std::string no_folder = folder.file("file");
  std::ofstream(no_folder) << "here no cache can be";
  Sender sender(broker, 40);
  ASSERT_TRUE(sender.send_first());
  const LogSink sink = [](LogLevel level, std::string_view) {
    if (level == LogLevel::kWarning) throw std::runtime_error("disk full");
  };
  auto made = Subscriber::create({broker.url("live/ball"), {}, no_folder}, sink);
  ASSERT_TRUE(made);
  EXPECT_TRUE(eventually([&] {
    (void)(*made)->poll(milliseconds(5));
    return (*made)->stats().detail.find("disk full") != std::string::npos;
  })) << (*made)->stats().detail;
}

TEST(Stream, NewSurfaceReplacesTheOldOnceDrawable) {
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

}  // namespace
}  // namespace eigencast
