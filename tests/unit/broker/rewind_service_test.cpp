// SPDX-License-Identifier: MIT
//
// What a whole broker shows of the past.
#include <fstream>
#include <random>

#include "broker/access/token_file.h"
#include "broker/storage/history.h"
#include "common/wire/limits.h"
#include "tests/support/process.h"
#include "tests/unit/broker/service.h"

namespace eigencast::broker {
namespace {

using namespace testing;
/// A broker that has been keeping a stream of 30 keys a second for three minutes, until ten seconds ago.
class RewindServiceTest : public ServiceTest {
 protected:
  using History = control::History;
  using Seek = control::Seek;
  using StreamInfo = control::StreamInfo;
  static constexpr TimeUs kSecond = 1'000'000, kEvery = kSecond / 30;
  static constexpr TimeUs kSendersClock = 3600 * kSecond;  ///< Ahead: this machine may have started just now.
  static constexpr int kKeys = 170 * 30;
  static inline const std::string kStream = "lab/horse";

  void SetUp() override {
    make_history();
    config_.history.streams = {"lab/**"};
    start();
  }
  void make_history() {
    const auto assets = AssetStore::open(folder_ + "/elsewhere", {}).value();
    Recorder::Settings settings;
    settings.folder = folder_ + "/history";
    settings.streams = StreamPatterns::from(std::vector<std::string>{"**"}).value();
    settings.checkpoint_us = 5 * kSecond;
    settings.keep_us = 3600 * kSecond;
    Recorder recorder(settings, *assets, {});
    Stream::Settings of_stream;
    of_stream.taps = {&recorder};
    Stream stream(kStream, 1, of_stream);
    FakeSender sender;
    ASSERT_TRUE(stream.claim(sender));
    ASSERT_TRUE(stream.announce(small_announce(), 1));
    sender.tag = stream.tag();
    TimeUs now_us = steady_now_us() - 180 * kSecond;
    first_us_ = recorder.unix_from_steady(now_us);
    for (int i = 0; i < kKeys; ++i, now_us += kEvery)
      ASSERT_TRUE(stream.add_frame(sender.next(kSendersClock + now_us), now_us));
    stream.release(sender);
  }
  /// Of a moment in the past.
  static TimeUs at(int sequence) { return first_us_ + sequence * kEvery; }
  /// A viewer, told once what is kept.
  std::unique_ptr<Client> viewer(const std::string& query = "?rate=raw") {
    auto client = std::make_unique<Client>(port_, "/v1/subscribe/" + kStream + query);
    told_ = client->wait_for<History>();
    while (told_.spans.empty() && !client->failed()) {  // It has just started.
      client->send(History{kStream});
      told_ = client->wait_for<History>();
    }
    return client;
  }
  /// The answer to a seek; its code, if it was not done.
  static std::string answer(Client& client, StreamInfo& info) {
    for (;;) {
      const auto message = client.next_control();
      if (client.failed()) return "closed";
      if (const auto* history = std::get_if<History>(&message); history != nullptr && !history->code.empty())
        return history->code;
      const auto* told = std::get_if<StreamInfo>(&message);
      if (told == nullptr) continue;
      info = *told;
      return "";
    }
  }
  /// The number of the next frame of an epoch.
  static std::uint64_t frame_of(Client& client, const StreamInfo& info) {
    for (;;) {
      const FramePtr frame = client.next_frame();
      if (!frame) {
        ADD_FAILURE() << "closed";
        return 0;
      }
      if (frame->envelope.stream_id == info.stream_id && frame->envelope.tag == info.tag)
        return frame->envelope.sequence;
    }
  }

  static inline TimeUs first_us_ = 0;
  History told_;
};

TEST_F(RewindServiceTest, ShowsAnyMomentWhileTheSenderGoesOn) {
  auto sending = sender(kStream);
  FakeSender sends;
  sending->send_frame(sends.next(1'000'000));
  auto client = viewer();
  ASSERT_GE(told_.spans.size(), 1U);
  EXPECT_EQ(told_.spans[0].from_us, first_us_);
  EXPECT_GE(told_.now_us, told_.spans[0].to_us);
  EXPECT_EQ(told_.code, "");
  StreamInfo past;
  for (const int sequence : {0, 4000, 17, kKeys - 1}) {
    client->send(Seek{kStream, at(sequence) + (sequence + 1 < kKeys ? 5 : 0), false, 0});
    ASSERT_EQ(answer(*client, past), "");
    ASSERT_TRUE(past.rewind);
    EXPECT_EQ(past.state, StreamInfo::State::kLive);
    EXPECT_EQ(past.asset, small_announce().asset);
    EXPECT_EQ(past.rewind->at_us, at(sequence));
    EXPECT_EQ(past.rewind->speed, 0);
    const FramePtr join = client->next_frame();
    ASSERT_TRUE(join);
    EXPECT_EQ(join->envelope.sequence, static_cast<std::uint64_t>(sequence));
    EXPECT_EQ(join->envelope.capture_us, past.rewind->capture_us);
    const auto parsed = parse_frame(join->message()).value();
    EXPECT_EQ(decode_join(small_layout(), parsed.envelope.bands, parsed.payload)->newer.q, key_number(sequence).q);
  }
  client->send(Seek{kStream, at(100), true, 0});
  ASSERT_EQ(answer(*client, past), "");
  EXPECT_EQ(past.rewind->at_us, at(101));
  sending->send_frame(sends.next(1'033'000));
  client->send(control::Subscribe{kStream, kRaw});
  StreamInfo live;
  ASSERT_EQ(answer(*client, live), "");
  EXPECT_FALSE(live.rewind);
  EXPECT_EQ(live.epoch, announced_.epoch);
  EXPECT_LT(live.epoch, past.epoch);
  while (frame_of(*client, live) != 1) ASSERT_FALSE(HasFailure());
}

TEST_F(RewindServiceTest, PlaysOnAndReturnsToLiveByItself) {
  auto client = viewer();
  StreamInfo past;
  client->send(Seek{kStream, at(kKeys - 60), false, 10});
  ASSERT_EQ(answer(*client, past), "");
  ASSERT_TRUE(past.rewind);
  EXPECT_EQ(past.profile.rate, Profile::Rate::kRaw);
  EXPECT_EQ(past.key_rate_hz, 300);
  std::uint64_t newest = frame_of(*client, past);
  EXPECT_EQ(newest, static_cast<std::uint64_t>(kKeys - 60));
  StreamInfo live;
  ASSERT_EQ(answer(*client, live), "");
  EXPECT_FALSE(live.rewind);
  EXPECT_EQ(live.state, StreamInfo::State::kWaiting) << "its sender is gone";
  // At the end already: live, too.
  client->send(Seek{kStream, limits::kMaxTimeUs});
  ASSERT_EQ(answer(*client, live), "");
  EXPECT_FALSE(live.rewind);
}

TEST_F(RewindServiceTest, TheBrokerEndsWhileAViewerThatSaysNothingSeesThePast) {
  stop();
  config_.timeouts.shutdown_ms = 50;
  start();
  auto client = viewer();
  client->send(Seek{kStream, at(300), false, 0.5});
  StreamInfo past;
  ASSERT_EQ(answer(*client, past), "");
  ASSERT_TRUE(client->next_frame());
  stop();
}

TEST_F(RewindServiceTest, PosesBetweenKeysArePacedAsLive) {
  auto client = viewer("?rate=interpolated&k=3");
  client->send(Seek{kStream, at(300), false, 0.5});
  StreamInfo past;
  ASSERT_EQ(answer(*client, past), "");
  EXPECT_EQ(past.profile.rate, Profile::Rate::kInterpolated);
  int steps = 0;
  TimeUs capture_us = 0;
  while (steps < 30) {
    const FramePtr frame = client->next_frame();
    ASSERT_TRUE(frame);
    if (frame->envelope.kind == FrameKind::kStep) ++steps;
    EXPECT_GE(frame->envelope.capture_us + 4 * kEvery, capture_us);
    capture_us = frame->envelope.capture_us;
  }
  // The moment that is shown follows from the time of capture.
  const double passed = static_cast<double>(capture_us - past.rewind->capture_us) * past.rewind->speed;
  EXPECT_GT(passed, 0);
  EXPECT_LT(passed, 60.0 * kSecond);
}

TEST_F(RewindServiceTest, TakesTheRightToRewind) {
  const auto may = create_static_token("may", {}, {"**"}, false, {}, {"lab/**", "else/**"});
  const auto may_not = create_static_token("may-not", {}, {"**"}, false, {"**"});
  std::ofstream(folder_ + "/tokens") << may->line << "\n" << may_not->line << "\n";
  stop();
  config_.access.tokens_file = folder_ + "/tokens";
  config_.access.anonymous_rewind = {};
  start();
  StreamInfo info;
  for (const std::string& query : {std::string(), "?access_token=" + may_not->token}) {
    Client client(port_, "/v1/subscribe/" + kStream + query);
    client.send(Seek{kStream, at(5)});
    client.send(History{kStream});
    for (const auto& told : {client.wait_for<History>(), client.wait_for<History>()}) {
      EXPECT_EQ(told.code, "refused");
      EXPECT_TRUE(told.spans.empty());
    }
  }
  auto client = viewer("?access_token=" + may->token);
  client->send(Seek{kStream, at(5), false, 0});
  EXPECT_EQ(answer(*client, info), "");
  EXPECT_TRUE(info.rewind);
  client->send(Seek{"lab/other", at(5)});
  EXPECT_EQ(answer(*client, info), "not-found") << "it is not watched";
  client->send(control::Subscribe{"else/where", {}});
  client->send(Seek{"else/where", at(5)});
  for (;;) {
    const auto history = client->wait_for<History>();
    ASSERT_FALSE(client->failed());
    if (history.stream != "else/where") continue;
    EXPECT_EQ(history.code, "not-found") << "nothing of it is kept";
    break;
  }
}

TEST_F(RewindServiceTest, SoManySeeThePastAndNoMore) {
  stop();
  config_.history.max_viewers = 1;
  start();
  StreamInfo info;
  auto one = viewer(), two = viewer();
  one->send(Seek{kStream, at(5), false, 0});
  ASSERT_EQ(answer(*one, info), "");
  two->send(Seek{kStream, at(5), false, 0});
  EXPECT_EQ(answer(*two, info), "refused");
  one->send(Seek{kStream, at(7), false, 0});
  EXPECT_EQ(answer(*one, info), "") << "who sees it may seek";
  one->send(control::Unsubscribe{kStream});
  one->send(control::Ping{1, 1});
  one->wait_for<control::Pong>();
  two->send(Seek{kStream, at(5), false, 0});
  EXPECT_EQ(answer(*two, info), "");
  two.reset();
  auto three = viewer();
  ASSERT_TRUE(::eigencast::testing::eventually([&] {
    three->send(Seek{kStream, at(5), false, 0});
    return answer(*three, info).empty();
  })) << "a viewer that is gone";
}

TEST_F(RewindServiceTest, StormsOfSeeksEndWithTheLastAndLoseNobodyAKey) {
  auto sending = sender(kStream);
  FakeSender sends;
  sending->send_frame(sends.next(1'000'000));
  auto live = std::make_unique<Client>(port_, "/v1/subscribe/" + kStream + "?rate=raw");
  ASSERT_TRUE(live->next_frame());
  auto client = viewer();
  std::mt19937_64 random(3);
  constexpr double kSpeeds[] = {0, 0.1, 1, 10};
  for (int i = 0; i < 600; ++i) {
    const TimeUs anywhere = static_cast<TimeUs>(random() >> 2);
    const TimeUs at_us = i % 3 == 0 ? anywhere : i % 3 == 1 ? at(static_cast<int>(random() % kKeys)) : TimeUs{0};
    client->send(Seek{kStream, at_us, i % 2 == 0, kSpeeds[random() % 4]});
    if (i % 10 != 0) continue;
    if (i % 50 == 0) client->send(control::Subscribe{kStream, kRaw});
    sending->send_frame(sends.next(2'000'000 + i * 1000));
    const FramePtr frame = live->next_frame();
    ASSERT_TRUE(frame);
    EXPECT_EQ(frame->envelope.sequence, static_cast<std::uint64_t>(i / 10 + 1));
  }
  client->send(Seek{kStream, at(1234), false, 0});
  StreamInfo info;
  do {
    (void)answer(*client, info);  // The file of the present may have no pose yet.
    ASSERT_FALSE(client->failed());
  } while (!info.rewind || info.rewind->at_us != at(1234));
  client->send(control::Ping{1, 1});
  client->wait_for<control::Pong>();
  EXPECT_FALSE(client->failed());
}

TEST_F(RewindServiceTest, MalformedSeeksCloseTheConnection) {
  for (const char* fields : {R"("at_us":-1)", R"("at_us":1,"speed":11)", R"("at_us":1,"speed":-1)",
                             R"("at_us":1,"speed":NaN)", R"("at_us":4611686018427387904)", R"("speed":1)"}) {
    Client client(port_, "/v1/subscribe/" + kStream);
    client.send_text(R"({"op":"seek","stream":"lab/horse",)" + std::string(fields) + "}");
    EXPECT_EQ(client.close_code(), 1007) << fields;
  }
}

TEST_F(RewindServiceTest, SendersThatComeAndGoDisturbNoPast) {
  auto client = viewer();
  client->send(Seek{kStream, at(300), false, 1});
  StreamInfo past;
  ASSERT_EQ(answer(*client, past), "");
  for (int i = 0; i < 3; ++i) {
    auto sending = sender(kStream);
    FakeSender sends;
    sending->send_frame(sends.next(1'000'000));
  }
  std::uint64_t last = frame_of(*client, past);
  for (int i = 0; i < 20; ++i) {
    const std::uint64_t next = frame_of(*client, past);
    EXPECT_GT(next, last);
    last = next;
  }
  client->send(control::Subscribe{kStream, kRaw});
  StreamInfo live;
  ASSERT_EQ(answer(*client, live), "");
  EXPECT_FALSE(live.rewind);
}

}  // namespace
}  // namespace eigencast::broker
