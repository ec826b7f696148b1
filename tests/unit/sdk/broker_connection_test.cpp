// SPDX-License-Identifier: MIT
// Streams that share the connection to their broker.
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <set>
#include <sstream>

#include "common/wire/envelope.h"
#include "common/wire/limits.h"
#include "sdk/broker.h"
#include "tests/unit/sdk/ball_stream.h"
#include "tests/unit/sdk/scripted_broker.h"

namespace eigencast {
namespace {

using Subscribers = std::vector<std::unique_ptr<Subscriber>>;

std::string stream_name(int i) {
  return "live/ball-" + std::to_string(i);
}

/// identity  streams of different ones share no connection
std::unique_ptr<Subscriber> watch(const std::string& url, const std::string& identity = {}) {
  SubscriberOptions options;
  options.url = url;
  options.profile = Profile{.rate = Profile::Rate::kRaw};
  options.declined_retry = milliseconds(100);
  options.credentials.ca_file = identity;  // Has no effect without TLS.
  auto made = Subscriber::create(std::move(options));
  EXPECT_TRUE(made) << made.error().message;
  return std::move(*made);
}

Subscriber::State state_of(Subscriber& subscriber) {
  (void)subscriber.poll(milliseconds(1));
  return subscriber.stats().state;
}

bool all_are(const Subscribers& subscribers, Subscriber::State state) {
  return std::all_of(subscribers.begin(), subscribers.end(), [&](auto& s) { return state_of(*s) == state; });
}

long threads_of_this_process() {
  return std::distance(std::filesystem::directory_iterator("/proc/self/task"), {});
}

/// Established connections to a port of this machine.
int connections_to(int port) {
  std::ostringstream suffix;
  suffix << ":" << std::hex << std::uppercase << std::setw(4) << std::setfill('0') << port;
  int count = 0;
  for (const char* path : {"/proc/self/net/tcp", "/proc/self/net/tcp6"}) {
    std::ifstream file(path);
    std::string number, local, remote, state, rest;
    while (file >> number >> local >> remote >> state && std::getline(file, rest)) {
      count += remote.ends_with(suffix.str()) && state == "01" ? 1 : 0;
    }
  }
  return count;
}

std::string waiting(const std::string& stream, std::uint32_t id) {
  control::StreamInfo info;
  info.stream = stream;
  info.stream_id = id;
  return text_from_control(info);
}

TEST(RetryLog, TroublesAreNamedOnceThenCounted) {
  RetryLog log;
  EXPECT_EQ(log.succeeded(), "") << "the first try";
  int lines = 0;
  for (int i = 0; i < 150; ++i) lines += log.failed(i % 2 == 0 ? "no broker at a" : "no broker at b").empty() ? 0 : 1;
  EXPECT_EQ(lines, 4) << "one of each broker, the 10th and the 100th try";
  EXPECT_NE(log.failed("refused").find("refused"), std::string::npos) << "another trouble";
  EXPECT_NE(log.succeeded().find("151"), std::string::npos);
  EXPECT_EQ(log.failed("no broker at a"), "no broker at a") << "counted anew";
  EXPECT_EQ(log.succeeded(), "") << "a single one";
}

TEST(BrokerConnection, TwentyStreamsTakeFourThreadsAndOneConnection) {
  LoopbackBroker broker;
  std::vector<std::unique_ptr<Sender>> senders;
  for (int i = 0; i < 20; ++i) {
    senders.push_back(std::make_unique<Sender>(broker, 8, CodecKind::kFloat64, stream_name(i)));
    ASSERT_TRUE(senders.back()->send_first());
  }
  // Uploads are over: what comes now are the subscribers'.
  ASSERT_TRUE(eventually([&] {
    const bool live = std::all_of(senders.begin(), senders.end(), [](const auto& sender) {
      return sender->publisher->stats().state == Publisher::State::kLive;
    });
    return live && connections_to(broker.port()) == 20;
  }));
  const long threads = threads_of_this_process();
  const int connections = connections_to(broker.port());
  Subscribers subscribers;
  for (int i = 0; i < 20; ++i) {
    subscribers.push_back(watch("ws://localhost:" + std::to_string(broker.port()) + "/" + stream_name(i)));
  }
  long max_threads = 0;
  int max_connections = 0;
  ASSERT_TRUE(eventually([&] {
    const bool complete = std::all_of(subscribers.begin(), subscribers.end(), [](auto& s) {
      (void)s->poll(milliseconds(1));
      return s->asset() != nullptr && s->asset()->complete();
    });
    max_threads = std::max(max_threads, threads_of_this_process() - threads);
    max_connections = std::max(max_connections, connections_to(broker.port()) - connections);
    return complete;
  }));
  EXPECT_LE(1 + max_threads, 4) << "with the caller's";
  EXPECT_LE(max_connections, 2) << "one for frames, one for surfaces";
  for (auto& sender : senders) EXPECT_EQ(sender->publisher->stats().subscribers, 1u);
  subscribers.clear();
  EXPECT_EQ(threads_of_this_process(), threads);
}

TEST(BrokerConnection, PosesEqualThoseOfSeparateConnections) {
  constexpr int kStreams = 5;
  constexpr std::size_t kPoses = 20;
  LoopbackBroker broker;
  std::vector<std::unique_ptr<Sender>> senders;
  Subscribers together, apart;
  for (int i = 0; i < kStreams; ++i) {
    senders.push_back(std::make_unique<Sender>(broker, 40, CodecKind::kQuantised, stream_name(i)));
    ASSERT_TRUE(senders.back()->send_first());
    together.push_back(watch(broker.url(stream_name(i))));
    apart.push_back(watch(broker.url(stream_name(i)), stream_name(i)));
  }
  std::vector<std::map<TimeUs, Coefficients>> of_together(kStreams), of_apart(kStreams);
  const auto collect = [](Subscriber& subscriber, std::map<TimeUs, Coefficients>& poses) {
    for (const ReceivedPose& p : subscriber.poll(milliseconds(1))) poses[p.envelope.capture_us] = p.coefficients;
  };
  std::size_t in_common = 0;
  ASSERT_TRUE(eventually([&] {
    std::size_t min = kPoses;
    for (std::size_t i = 0; i < kStreams; ++i) {
      (void)senders[i]->send();
      collect(*together[i], of_together[i]);
      collect(*apart[i], of_apart[i]);
      min = std::min({min, of_together[i].size(), of_apart[i].size()});
    }
    return min == kPoses;
  }));
  for (std::size_t i = 0; i < kStreams; ++i) {
    for (const auto& [capture_us, C] : of_together[i]) {
      EXPECT_EQ(C, senders[i]->received.at(capture_us));
      if (!of_apart[i].contains(capture_us)) continue;
      EXPECT_EQ(C, of_apart[i].at(capture_us));
      ++in_common;
    }
  }
  EXPECT_GT(in_common, 0u);
}

TEST(BrokerConnection, AllStreamsComeBackAfterARestart) {
  LoopbackBroker broker;
  const int connections = connections_to(broker.port());
  Subscribers subscribers;
  for (int i = 0; i < 8; ++i) subscribers.push_back(watch(broker.url(stream_name(i))));
  ASSERT_TRUE(eventually([&] { return all_are(subscribers, Subscriber::State::kWaiting); }));
  broker.stop();
  ASSERT_TRUE(eventually([&] { return all_are(subscribers, Subscriber::State::kLost); }));
  broker.start();
  ASSERT_TRUE(eventually([&] { return all_are(subscribers, Subscriber::State::kWaiting); }));
  EXPECT_EQ(connections_to(broker.port()) - connections, 1);
  for (const auto& subscriber : subscribers) EXPECT_EQ(subscriber->stats().reconnects, 1u);
  Sender sender(broker, 8, CodecKind::kFloat64, stream_name(5));
  ASSERT_TRUE(sender.send_first());
  EXPECT_GE(exchange(sender, *subscribers[5], 3).size(), 3u);
}

TEST(BrokerConnection, RefusedStreamDoesNotHarmOthers) {
  const auto answer = [](const std::string& stream) {
    if (stream != "secret") return waiting(stream, 7);
    return text_from_control(control::ErrorMessage{"refused", "no right", stream});
  };
  ScriptedBroker broker({{}, answer, false, "/v1/subscribe/secret"});
  Subscribers subscribers;
  subscribers.push_back(watch(broker.url("secret")));
  ASSERT_TRUE(eventually([&] { return state_of(*subscribers[0]) == Subscriber::State::kRefused; }));
  subscribers.push_back(watch(broker.url("open")));
  ASSERT_TRUE(eventually([&] { return state_of(*subscribers[1]) == Subscriber::State::kWaiting; }));
  // Asked again, and refused again, on the connection that the other one uses.
  ASSERT_TRUE(eventually([&] { return broker.received<control::Subscribe>().size() >= 4; }));
  EXPECT_EQ(state_of(*subscribers[0]), Subscriber::State::kRefused);
  EXPECT_EQ(state_of(*subscribers[1]), Subscriber::State::kWaiting);
  EXPECT_EQ(broker.targets().back(), "/v1/subscribe");
  EXPECT_EQ(broker.targets().size(), 2u);
}

TEST(BrokerConnection, SingleStreamIsNamedInTheUrl) {
  ScriptedBroker broker({{waiting("live/ball", 7)}});
  const auto subscriber = watch(broker.url("live/ball"));
  ASSERT_TRUE(eventually([&] { return state_of(*subscriber) == Subscriber::State::kWaiting; }));
  ASSERT_EQ(broker.targets().size(), 1u);
  EXPECT_TRUE(broker.targets()[0].starts_with("/v1/subscribe/live/ball?"));
  EXPECT_TRUE(broker.received<control::Subscribe>().empty());
}

TEST(BrokerConnection, TooLongControlMessageCostsItselfOnly) {
  control::Trace trace;
  trace.stages.assign(16, {std::string(4096, 'x'), 1});
  const std::string too_long = text_from_control(trace);
  ASSERT_GT(too_long.size(), limits::kMaxControlBytes);
  ScriptedBroker broker({{too_long, std::string(200'000, '['), waiting("live/ball", 7)}});
  const auto subscriber = watch(broker.url("live/ball"));
  ASSERT_TRUE(eventually([&] { return state_of(*subscriber) == Subscriber::State::kWaiting; }));
  ASSERT_TRUE(eventually([&] { return !broker.received<control::Ping>().empty(); }));
  EXPECT_EQ(broker.targets().size(), 1u) << "one connection";
}

TEST(BrokerConnection, DestroyedSubscriberUnsubscribes) {
  ScriptedBroker broker({{}, [](const std::string& stream) { return waiting(stream, 7); }});
  const auto stays = watch(broker.url("stays"));
  auto goes = watch(broker.url("goes"));
  ASSERT_TRUE(eventually([&] { return state_of(*goes) == Subscriber::State::kWaiting; }));
  goes.reset();
  ASSERT_TRUE(eventually([&] { return broker.received<control::Unsubscribe>().size() == 1; }));
  EXPECT_EQ(broker.received<control::Unsubscribe>()[0].stream, "goes");
  EXPECT_EQ(broker.targets().size(), 1u);
}

TEST(BrokerConnection, AcknowledgementsAreSplitAtTheLimit) {
  constexpr int kStreams = 70;
  ScriptedBroker::Script script;
  script.at_first = {waiting(stream_name(0), 1)};
  script.to_subscribe = [](const std::string& stream) {
    return waiting(stream, static_cast<std::uint32_t>(1 + std::stoi(stream.substr(stream.find('-') + 1))));
  };
  script.streams = kStreams - 1;  // The URL may name the first one.
  for (std::uint32_t id = 1; id <= kStreams; ++id) {
    Envelope envelope;
    envelope.kind = FrameKind::kJoin;
    envelope.bands = 1;
    envelope.stream_id = id;
    script.frames.emplace_back();
    append_envelope(envelope, nullptr, script.frames.back());
    script.frames.back().push_back(0);
  }
  ScriptedBroker broker(std::move(script));
  Subscribers subscribers;
  for (int i = 0; i < kStreams; ++i) subscribers.push_back(watch(broker.url(stream_name(i))));
  const auto acknowledged = [&] {
    std::set<std::uint32_t> ids;
    for (const control::Ack& ack : broker.received<control::Ack>()) {
      EXPECT_LE(ack.items.size(), limits::kMaxAcksPerMessage);
      for (const auto& item : ack.items) ids.insert(item.stream_id);
    }
    return ids.size();
  };
  EXPECT_TRUE(eventually([&] { return acknowledged() == kStreams; })) << acknowledged();
}

TEST(BrokerConnection, FullConnectionIsFollowedByAnother) {
  LoopbackBroker broker(3);
  const int connections = connections_to(broker.port());
  Subscribers subscribers;
  for (int i = 0; i < 7; ++i) subscribers.push_back(watch(broker.url(stream_name(i))));
  EXPECT_TRUE(eventually([&] { return all_are(subscribers, Subscriber::State::kWaiting); }));
  EXPECT_EQ(connections_to(broker.port()) - connections, 3);
}

TEST(BrokerConnection, SameStreamTwiceTakesTwoConnections) {
  LoopbackBroker broker;
  const int connections = connections_to(broker.port());
  Subscribers subscribers;
  for (int i = 0; i < 2; ++i) subscribers.push_back(watch(broker.url(stream_name(0))));
  EXPECT_TRUE(eventually([&] { return all_are(subscribers, Subscriber::State::kWaiting); }));
  EXPECT_EQ(connections_to(broker.port()) - connections, 2);
}

TEST(BrokerConnection, TokensThatDifferTakeTwoConnections) {
  ScriptedBroker broker(
      {{waiting("a", 1), waiting("b", 2)}, [](const std::string& stream) { return waiting(stream, 3); }});
  Subscribers subscribers;
  for (const char* stream : {"a?access_token=one", "b?access_token=two", "c?access_token=one"}) {
    subscribers.push_back(watch(broker.url(stream)));
    ASSERT_TRUE(eventually([&] { return all_are(subscribers, Subscriber::State::kWaiting); })) << stream;
  }
  EXPECT_EQ(broker.tokens(), (std::vector<std::string>{"Bearer one", "Bearer two"}));
  ASSERT_EQ(broker.received<control::Subscribe>().size(), 1u) << "equal tokens share a connection";
  EXPECT_EQ(broker.received<control::Subscribe>()[0].stream, "c");
}

TEST(BrokerConnection, TokensThatDifferShareNothing) {
  struct Shared {
    explicit Shared(const BrokerUrl& url) : token(url.credentials.token) {}
    const std::string token;
  };
  SharedByBroker<Shared> all;
  const auto accepts = [](const Shared&) { return true; };
  const auto get = [&](const std::string& url) { return all.get(*parse_broker_url(url), accepts); };
  const auto one = get("ws://host/a?access_token=one");
  EXPECT_EQ(get("http://host:80/b?access_token=one"), one);
  EXPECT_NE(get("ws://host/a?access_token=two"), one);
  EXPECT_NE(get("ws://host:1/a?access_token=one"), one);
  EXPECT_NE(get("wss://host/a?access_token=one"), one);
  EXPECT_NE(get("ws://host/proxied/v1/subscribe/a?access_token=one"), one);
  EXPECT_EQ(get("ws://host/a?access_token=two")->token, "two");
}

}  // namespace
}  // namespace eigencast
