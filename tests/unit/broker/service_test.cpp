// SPDX-License-Identifier: MIT
//
// What a whole broker sends to senders and viewers.
#include "tests/unit/broker/service.h"

#include <sys/inotify.h>
#include <unistd.h>

#include <atomic>
#include <filesystem>
#include <fstream>
#include <list>
#include <mutex>
#include <stdexcept>
#include <thread>

#include "broker/access/token_file.h"
#include "common/codec/pose_memory.h"
#include "common/core/files.h"

namespace eigencast::broker {
namespace {

namespace fs = std::filesystem;
using namespace testing;

/// A segment of poses that FakeSenders send, as an object.
std::string segment_of(int first, std::size_t count, const AssetDigest& asset,
                       const CoefficientLayout& layout = small_layout()) {
  std::vector<Key> keys(count, key_number(first));
  for (std::size_t i = 0; i < count; ++i) keys[i].q = key_number(first + static_cast<int>(i)).q;
  for (Key& key : keys) key.q.resize(layout.size());
  const Bytes bytes = encode_segment(layout, asset, keys, 1).value().bytes;
  return {bytes.begin(), bytes.end()};
}

TEST_F(ServiceTest, MemoriesAreTakenOrRefusedByCodeAndTheStreamGoesOn) {
  stop();
  config_.limits.max_control_bytes = 65'536;
  start();
  auto publisher = sender("a");
  Client viewer(port_, "/v1/subscribe/a?rate=raw");
  viewer.wait_for<control::StreamInfo>();
  FakeSender motion;
  FakeReceiver receiver;
  TimeUs now = 0;
  publisher->send_frame(motion.next(now));
  receiver.decode(*viewer.next_frame());
  std::uint32_t number = 0;
  const auto ask = [&](std::uint32_t kept, std::vector<std::string> ids) {
    publisher->send(control::Remember{"a", ++number, kept, std::move(ids)});
    const auto answer = publisher->wait_for<control::Remembered>();
    EXPECT_EQ(answer.generation, number);
    return answer.code;
  };
  const AssetDigest asset = Sha256::from_hex(asset_)->digest;
  const std::string good = segment_of(0, 20, asset), more = segment_of(20, 20, asset);
  EXPECT_EQ(ask(0, {std::string(64, 'e')}), "not-found");
  EXPECT_EQ(ask(0, {asset_}), "corrupt") << "a manifest";
  EXPECT_EQ(ask(0, {put_asset(segment_of(0, 20, {}))}), "corrupt") << "another asset's";
  const CoefficientLayout other{CodecKind::kQuantised, 9, 3, {4, 9}};
  EXPECT_EQ(ask(0, {put_asset(segment_of(0, 20, asset, other))}), "corrupt") << "of another layout";
  EXPECT_EQ(ask(0, {put_asset(good.substr(0, good.size() - 1))}), "corrupt");
  EXPECT_EQ(ask(0, {put_asset(segment_of(0, 1000, asset)), put_asset(segment_of(1, 25, asset))}), "too-large");
  const std::string first = put_asset(good), second = put_asset(more);
  EXPECT_EQ(ask(1, {first}), "invalid-argument") << "keeps what is not here";
  EXPECT_EQ(ask(0, {first}), "");
  EXPECT_EQ(ask(1, std::vector(256, second)), "invalid-argument");
  EXPECT_EQ(ask(1, {std::string(64, 'e')}), "not-found") << "and the one before stays";
  const auto told = viewer.wait_for<control::Remember>();
  EXPECT_EQ(told.segments, std::vector{first});
  EXPECT_EQ(told.kept, 0U);
  EXPECT_EQ(request("GET", "/v1/assets/" + told.segments[0]).body, good);
  EXPECT_EQ(request("GET", "/v1/assets/" + told.segments[0]).headers["Cache-Control"], "no-store");
  EXPECT_NE(request("GET", "/v1/streams").body.find("\"memory_poses\":20"), std::string::npos);
  EXPECT_EQ(ask(1, {second}), "");
  const auto appended = viewer.wait_for<control::Remember>();
  EXPECT_EQ(appended.segments, std::vector{second});
  EXPECT_EQ(appended.kept, 1U);
  EXPECT_GT(appended.generation, told.generation);
  PoseMemory memory(small_layout());
  for (const std::string& bytes : {good, more}) {
    const Bytes object(bytes.begin(), bytes.end());
    memory = memory.with(decode_segment(small_layout(), asset, object).value()).value();
  }
  receiver.memory = memory;
  // Who says nothing gets keys that need none; who names the generation the sender's.
  std::uint32_t held = 0;
  const auto recalled = [&](std::uint32_t phase) {
    publisher->send_frame(motion.next_recalled(now += 33'000, memory, phase));
    for (;;) {
      const FramePtr frame = viewer.next_frame();
      receiver.decode(*frame);
      const Envelope& head = frame->envelope;
      viewer.send(control::Ack{{{announced_.stream_id, head.sequence, head.step.byte(), held}}, now});
      if (head.capture_us == now) return head.is_recalled();
    }
  };
  EXPECT_FALSE(recalled(8));
  EXPECT_FALSE(recalled(16));
  held = appended.generation;
  std::uint32_t pose = 3;
  while (!recalled(8 * pose)) pose = pose % 30 + 1;
  EXPECT_TRUE(recalled(8 * 20));
  EXPECT_EQ(receiver.poses.back().key, motion.sent());
  EXPECT_EQ(receiver.undecodable, 0);
  // A new root: what was held is void at once.
  EXPECT_EQ(ask(0, {second}), "");
  motion.forget_phase();
  publisher->send_frame(motion.next_recalled(now += 33'000, memory, 8 * 20));
  EXPECT_EQ(publisher->close_code(), 1008) << "a pose that the memory does not have";
}

TEST_F(ServiceTest, BrokerThatKeepsNoMemorySaysSo) {
  stop();
  config_.memory.enabled = false;
  start();
  auto publisher = sender("a");
  publisher->send(control::Remember{"a", 7, 0, {std::string(64, 'e')}});
  EXPECT_EQ(publisher->wait_for<control::Remembered>().code, "unsupported");
  FakeSender motion;
  Client viewer(port_, "/v1/subscribe/a?rate=raw");
  publisher->send_frame(motion.next(0));
  EXPECT_EQ(viewer.next_frame()->envelope.sequence, 0U);
}

TEST_F(ServiceTest, PosesTravelFromSenderToViewers) {
  Client early(port_, "/v1/subscribe/a?rate=raw");
  EXPECT_EQ(early.wait_for<control::StreamInfo>().state, control::StreamInfo::State::kWaiting);
  auto publisher = sender("a");
  EXPECT_EQ(publisher->wait_for<control::Subscribers>().count, 1u);
  const auto info = early.wait_for<control::StreamInfo>();
  EXPECT_EQ(info.state, control::StreamInfo::State::kLive);
  EXPECT_EQ(info.epoch, announced_.epoch);
  FakeSender motion;
  FakeReceiver receiver;
  for (int i = 0; i < 20; ++i) {
    publisher->send_frame(motion.next(i * 33'000));
    receiver.decode(*early.next_frame());
    ASSERT_EQ(receiver.poses.back().key, key_number(i));
  }
  EXPECT_EQ(receiver.undecodable, 0);

  Client late(port_, "/v1/subscribe");
  late.send(control::Subscribe{"a", Profile{}});
  EXPECT_EQ(late.wait_for<control::StreamInfo>().stream_id, announced_.stream_id);
  const FramePtr join = late.next_frame();
  EXPECT_EQ(join->envelope.kind, FrameKind::kJoin);
  EXPECT_EQ(join->envelope.sequence, 19u);

  publisher.reset();
  EXPECT_EQ(late.wait_for<control::StreamInfo>().state, control::StreamInfo::State::kStalled);
  auto second = sender("a");
  EXPECT_GT(late.wait_for<control::StreamInfo>().epoch, info.epoch);
}

TEST_F(ServiceTest, InterpolationSendsThreePosesPerKey) {
  auto publisher = sender("a");
  Client viewer(port_, "/v1/subscribe/a");
  viewer.wait_for<control::StreamInfo>();
  FakeSender motion;
  FakeReceiver receiver;
  constexpr int kKeys = 6;
  std::thread feeding([&] {
    for (int i = 0; i < kKeys; ++i) {
      publisher->send_frame(motion.next(i * 20'000));
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
  });
  do {
    receiver.decode(*viewer.next_frame());
  } while (receiver.poses.empty() || receiver.poses.back().key != key_number(kKeys - 1));
  feeding.join();
  EXPECT_EQ(receiver.undecodable, 0);
  for (const auto& pose : receiver.poses) {
    const int s = static_cast<int>(pose.envelope.sequence);
    const auto [at, of] = pose.envelope.step;
    if (at == of) continue;
    EXPECT_EQ(pose.key, interpolate_keys(small_layout(), key_number(s - 1), key_number(s), at, of).value());
  }
}

TEST_F(ServiceTest, SecondSenderIsRefused) {
  auto first = sender("a");
  for (const bool announces : {true, false}) {  // One that says nothing, too, some time later.
    Client second(port_, "/v1/publish/a");
    if (announces) second.send(small_announce());
    EXPECT_EQ(second.wait_for<control::ErrorMessage>().code, "refused");
    EXPECT_EQ(second.close_code(), 1008);
  }
  first->send(control::Ping{7, 9});
  EXPECT_EQ(first->wait_for<control::Pong>().id, 7u);
}

/// Takes streams over, or tries to.
class ResumeTest : public ServiceTest {
 protected:
  std::unique_ptr<Client> announce(const std::string& secret, const std::string& token = {}) const {
    auto client = std::make_unique<Client>(port_, "/v1/publish/a" + (token.empty() ? "" : "?access_token=" + token));
    control::Announce message = small_announce();
    message.asset = asset_;
    message.resume = secret;
    client->send(message);
    return client;
  }
  void expect_refused(const std::string& secret, const std::string& token = {}) const {
    const auto client = announce(secret, token);
    EXPECT_EQ(client->wait_for<control::ErrorMessage>().code, "refused");
    EXPECT_EQ(client->close_code(), 1008);
  }
};

TEST_F(ResumeTest, SenderTakesItsOwnStreamOver) {
  auto first = sender("a");
  const control::Announced before = announced_;
  EXPECT_EQ(before.resume.size(), 64u);
  auto second = announce(before.resume);
  const auto after = second->wait_for<control::Announced>();
  EXPECT_GT(after.epoch, before.epoch);
  EXPECT_EQ(after.stream_id, before.stream_id);
  EXPECT_NE(after.resume, before.resume);
  EXPECT_EQ(first->close_code(), 4409);
  FakeSender motion;
  second->send_frame(motion.next(0));
  Client viewer(port_, "/v1/subscribe/a?rate=raw");
  EXPECT_EQ(viewer.wait_for<control::StreamInfo>().epoch, after.epoch);
  EXPECT_EQ(viewer.next_frame()->envelope.epoch, after.epoch);
}

TEST_F(ResumeTest, WrongAndOlderSecretsAreRefused) {
  auto first = sender("a");
  const std::string older = announced_.resume;
  auto second = announce(older);
  const std::string newest = second->wait_for<control::Announced>().resume;
  std::string other = newest;
  other.back() = other.back() == '0' ? '1' : '0';
  for (const std::string& wrong :
       {older, other, newest.substr(1), newest + "0", std::string("x"), std::string(1000, 'x'), std::string()}) {
    expect_refused(wrong);
  }
  second->send(control::Ping{7, 9});
  EXPECT_EQ(second->wait_for<control::Pong>().id, 7u) << "its sender does not notice";
  EXPECT_EQ(announce(newest)->wait_for<control::Announced>().stream, "a");
}

TEST_F(ResumeTest, WhoHoldsANameWithoutAnAnnouncementVoidsNoSecret) {
  auto first = sender("a");
  const std::string secret = announced_.resume;
  first.reset();
  Client holder(port_, "/v1/publish/a");
  holder.send(control::Ping{7, 9});
  holder.wait_for<control::Pong>();
  expect_refused({});
  const auto again = announce(secret);
  ASSERT_EQ(again->wait_for<control::Announced>().stream, "a");
  EXPECT_EQ(holder.close_code(), 4409);
  expect_refused(secret);
}

TEST_F(ResumeTest, NameIsNotHeldForEverWithoutAnAnnouncement) {
  stop();
  config_.timeouts.upload_ms = 100;
  start();
  auto first = sender("a");
  Client holder(port_, "/v1/publish/b");
  const auto code_of = [&](const std::string& name) {
    Client second(port_, "/v1/publish/" + name);
    control::Announce message = small_announce();
    message.asset = asset_;
    second.send(message);
    const auto answer = second.next_control();
    const auto* error = std::get_if<control::ErrorMessage>(&answer);
    return error != nullptr ? error->code : std::string();
  };
  while (code_of("b") == "refused") continue;
  EXPECT_EQ(holder.close_code(), 4409);
  EXPECT_EQ(code_of("a"), "refused") << "it has announced";
}

TEST_F(ResumeTest, SecretNeedsItsHolderAndTheRight) {
  const auto one = create_static_token("one", {"a"}, {}, false), two = create_static_token("two", {"a"}, {}, false),
             three = create_static_token("three", {"b"}, {}, false);
  std::ofstream(folder_ + "/tokens") << one->line << "\n" << two->line << "\n" << three->line << "\n";
  asset_ = put_asset("manifest");
  stop();
  config_.access.tokens_file = folder_ + "/tokens";
  start();
  auto first = announce({}, one->token);
  const std::string secret = first->wait_for<control::Announced>().resume;
  expect_refused(secret, two->token);
  EXPECT_EQ(Client(port_, "/v1/publish/a?access_token=" + three->token).status(), 403);
  EXPECT_EQ(announce(secret, one->token)->wait_for<control::Announced>().stream, "a");
}

TEST_F(ResumeTest, SecretIsShownNowhere) {
  std::mutex mutex;
  std::string lines;
  log_ = [&](LogLevel, std::string_view line) {
    const std::lock_guard lock(mutex);
    lines += std::string(line) + "\n";
  };
  config_.recording.streams = {"**"};
  stop();
  start();
  auto first = sender("a");
  const std::string secret = announced_.resume;
  auto second = announce(secret);
  const std::string newest = second->wait_for<control::Announced>().resume;
  expect_refused(secret);
  Client viewer(port_, "/v1/subscribe/a?rate=raw");
  FakeSender motion;
  second->send_frame(motion.next(0));
  EXPECT_NE(viewer.next_frame(), nullptr);
  std::string shown = request("GET", "/v1/streams").body;
  for (const char* path : {"/api/clients", "/api/streams", "/metrics"}) {
    shown += http_request(admin_port_, "GET", path).body;
  }
  stop();
  for (const auto& file : fs::recursive_directory_iterator(folder_)) {
    if (file.is_regular_file()) shown += *read_file(file.path(), 1 << 20);
  }
  shown += lines;
  EXPECT_NE(shown.find("manifest"), std::string::npos);
  EXPECT_EQ(shown.find(secret), std::string::npos);
  EXPECT_EQ(shown.find(newest), std::string::npos);
}

TEST_F(ServiceTest, MalformedFrameClosesOnlyItsSender) {
  auto bad = sender("bad");
  auto good = sender("good");
  bad->send_frame(Bytes(40, 0xff));
  EXPECT_EQ(bad->wait_for<control::ErrorMessage>().code, "corrupt");
  EXPECT_EQ(bad->close_code(), 1008);
  Client viewer(port_, "/v1/subscribe/good?rate=raw");
  FakeSender motion;
  good->send_frame(motion.next(0));
  EXPECT_EQ(viewer.next_frame()->envelope.sequence, 0u);
}

TEST_F(ServiceTest, CloseCodesMatchTheProtocol) {
  Client not_json(port_, "/v1/subscribe");
  not_json.send_text("{nonsense");
  EXPECT_EQ(not_json.wait_for<control::ErrorMessage>().code, "corrupt");
  EXPECT_EQ(not_json.close_code(), 1007);
  Client bad_utf8(port_, "/v1/subscribe");
  bad_utf8.send_text("\xff\xfe");
  EXPECT_EQ(bad_utf8.close_code(), 1007);
  Client binary(port_, "/v1/subscribe");
  binary.send_frame(Bytes(10, 1));
  EXPECT_EQ(binary.wait_for<control::ErrorMessage>().code, "invalid-argument");
  EXPECT_EQ(binary.close_code(), 1003);
  Client large(port_, "/v1/subscribe");
  large.send_text(std::string(10'000, ' '));
  EXPECT_EQ(large.wait_for<control::ErrorMessage>().code, "too-large");
  EXPECT_EQ(large.close_code(), 1009);
  Client large_announce(port_, "/v1/publish/a");
  large_announce.send_text(std::string(10'000, ' '));
  EXPECT_EQ(large_announce.wait_for<control::ErrorMessage>().code, "too-large") << "over limits.max_control_bytes";
  EXPECT_EQ(large_announce.close_code(), 1009);
  Client much_too_large(port_, "/v1/publish/b");
  much_too_large.send_frame(Bytes(3'000'000, 1));
  EXPECT_EQ(much_too_large.close_code(), 1009);
  Client unknown(port_, "/v1/subscribe");
  unknown.send_text(R"({"op":"dance"})");
  EXPECT_EQ(unknown.wait_for<control::ErrorMessage>().code, "unsupported");
  unknown.send(control::Ping{1, 2});
  EXPECT_EQ(unknown.wait_for<control::Pong>().time_us, 2) << "an unknown op does not close";
}

TEST_F(ServiceTest, UpgradesAreChecked) {
  for (const char* protocol : {"", "eigencast.v1", "chat"}) {
    Client client(port_, "/v1/subscribe/a", protocol);
    EXPECT_EQ(client.status(), 400) << protocol;
  }
  EXPECT_EQ(Client(port_, "/v1/subscribe/a?rate=99").status(), 400);
  EXPECT_EQ(Client(port_, "/v1/subscribe/a/../b").status(), 400);
  EXPECT_EQ(Client(port_, "/nothing").status(), 404);
  EXPECT_EQ(request("GET", "/v1/subscribe/a").status, 426);
  const Client several(port_, "/v1/subscribe/a", "chat, eigencast.v2");
  EXPECT_EQ(several.subprotocol(), "eigencast.v2");
}

TEST_F(ServiceTest, AnnouncementsAreChecked) {
  Client client(port_, "/v1/publish/a");
  control::Announce announce = small_announce();
  client.send(announce);
  EXPECT_EQ(client.wait_for<control::ErrorMessage>().code, "not-found");
  announce.asset = put_asset("x");
  client.send(announce);
  EXPECT_EQ(client.wait_for<control::Announced>().stream, "a")
      << "after the asset was put, the same connection goes on";
}

/// How often a file of the folder was put in place.
class Watch {
 public:
  explicit Watch(const std::string& folder) : fd_(::inotify_init1(IN_NONBLOCK | IN_CLOEXEC)) {
    EXPECT_GE(::inotify_add_watch(fd_.get(), folder.c_str(), IN_MOVED_TO), 0);
  }
  int moves() {
    alignas(inotify_event) char buffer[4096];
    for (ssize_t size = 0; (size = ::read(fd_.get(), buffer, sizeof buffer)) > 0;) {
      for (const char* at = buffer; at < buffer + size; ++moves_) {
        at += sizeof(inotify_event) + reinterpret_cast<const inotify_event*>(at)->len;
      }
    }
    return moves_;
  }

 private:
  FileHandle fd_;
  int moves_ = 0;
};

TEST_F(ServiceTest, AFloodOfAnnouncementsIsNotWritten) {
  config_.limits.control_messages_per_s = 10'000'000;
  stop();
  start();
  auto flood = sender("flood");
  Watch watch(folder_);
  control::Announce announce = small_announce();
  announce.asset = asset_;
  std::uint32_t last = announced_.epoch;
  for (int batch = 0; batch < 10; ++batch) {
    for (int i = 0; i < 100; ++i) flood->send(announce);
    for (int i = 0; i < 100; ++i) {
      const std::uint32_t epoch = flood->wait_for<control::Announced>().epoch;
      EXPECT_GT(epoch, last);
      last = epoch;
    }
  }
  EXPECT_LE(watch.moves(), 100) << "of 1000 epochs";
  std::uint32_t kept = 0;
  std::ifstream(folder_ + "/epoch") >> kept;
  EXPECT_GT(kept, last) << "a broker that crashes now goes on above";
}

TEST_F(ServiceTest, FastAskersAreReadLater) {
  std::atomic<int> told = 0;
  log_ = [&](LogLevel, std::string_view line) {
    if (line.find("limits.control_messages_per_s") != std::string_view::npos) ++told;
  };
  config_.limits.control_messages_per_s = 100;
  config_.timeouts.idle_ms = 1000;
  stop();
  start();
  auto flood = sender("flood");
  control::Announce announce = small_announce();
  announce.asset = asset_;
  for (int i = 0; i < 4; ++i) flood->send(announce);
  for (int i = 0; i < 4; ++i) flood->wait_for<control::Announced>();
  EXPECT_GT(told, 0) << "each counts as 100";
  const int before = told;
  Client viewer(port_, "/v1/subscribe");
  for (int i = 0; i < 20; ++i) viewer.send(control::Subscribe{"s" + std::to_string(i), Profile{}});
  viewer.send(control::Ping{7, 9});
  bool heard = false;
  for (bool ponged = false; !ponged && !viewer.failed();) {
    const auto message = viewer.next_control();
    if (const auto* notice = std::get_if<control::Notice>(&message)) heard = heard || notice->stream.empty();
    ponged = std::holds_alternative<control::Pong>(message);
  }
  EXPECT_FALSE(viewer.failed()) << "none is lost, and nobody is closed for silence that is not his";
  EXPECT_TRUE(heard) << "and is told why";
  EXPECT_GT(told, before);
  stop();
}

TEST_F(ServiceTest, LongMessagesCountAsSeveral) {
  std::atomic<int> told = 0;
  log_ = [&](LogLevel, std::string_view line) {
    if (line.find("limits.control_messages_per_s") != std::string_view::npos) ++told;
  };
  config_.limits.control_messages_per_s = 100;
  stop();
  start();
  Client viewer(port_, "/v1/subscribe");
  for (int i = 0; i < 20; ++i) {
    viewer.send_text(R"({"op":"ping","id":7,"time_us":9,"more":")" + std::string(4000, 'x') + "\"}");
  }
  for (int i = 0; i < 20; ++i) EXPECT_EQ(viewer.wait_for<control::Pong>().id, 7u);
  EXPECT_GT(told, 0);
  stop();
}

TEST_F(ServiceTest, KeysBeyondTheBudgetAreReadLater) {
  std::atomic<int> told = 0;
  log_ = [&](LogLevel, std::string_view line) {
    if (line.find("work_us_per_s") != std::string_view::npos) ++told;
  };
  config_.per_address.work_us_per_s = 5'000;
  stop();
  start();
  auto flood = sender("a");
  Client viewer(port_, "/v1/subscribe/a?rate=raw");
  viewer.wait_for<control::StreamInfo>();
  FakeSender motion;
  for (int i = 0; i < 200; ++i) flood->send_frame(motion.next(i));
  for (std::uint64_t newest = 0; newest < 199;) {  // A slow viewer may miss some.
    const FramePtr frame = viewer.next_frame();
    ASSERT_NE(frame, nullptr);
    newest = frame->envelope.sequence;
  }
  flood->send(control::Ping{7, 9});
  EXPECT_EQ(flood->wait_for<control::Pong>().id, 7u);
  EXPECT_GT(told, 0);
  stop();
}

TEST_F(ServiceTest, PosesBeyondTheBudgetOfTheirViewersAreLeftOut) {
  config_.per_address.work_us_per_s = 1'000;
  stop();
  start();
  const auto sends = sender("a");
  std::list<Client> viewers;
  for (const char* query : {"k=15&scheme=catmull-rom", "k=14&scheme=catmull-rom"})
    viewers.emplace_back(port_, std::string("/v1/subscribe/a?") + query).wait_for<control::StreamInfo>();
  const auto left_out = [&] {
    const std::string metrics = http_request(admin_port_, "GET", "/metrics").body;
    return metrics.find("\neigencast_broker_poses_failed 0\n") == std::string::npos;
  };
  FakeSender motion;
  std::uint64_t sent = 0;
  for (TimeUs at = 0; sent < 20 || !left_out(); at += kInterval, ++sent) {
    sends->send_frame(motion.next(at));
    std::this_thread::sleep_for(std::chrono::microseconds(kInterval));
  }
  for (std::uint64_t newest = 0; newest + 2 < sent;) {
    const FramePtr frame = viewers.front().next_frame();
    ASSERT_NE(frame, nullptr);
    if (frame->envelope.is_key()) newest = frame->envelope.sequence;
  }
  stop();
}

TEST_F(ServiceTest, AllowedStreamsAreSubscribedAtOnce) {
  std::atomic<bool> told = false;
  log_ = [&](LogLevel, std::string_view line) {
    if (line.find("limits.control_messages_per_s") != std::string_view::npos) told = true;
  };
  stop();
  start();
  Client viewer(port_, "/v1/subscribe");
  for (int i = 0; i < 64; ++i) viewer.send(control::Subscribe{"s" + std::to_string(i), Profile{}});
  for (int i = 0; i < 64; ++i) viewer.wait_for<control::StreamInfo>();
  EXPECT_FALSE(told);
  stop();
}

TEST_F(ServiceTest, WithAFullDiskStreamsGoOn) {
  std::mutex mutex;
  std::string lines;
  log_ = [&](LogLevel, std::string_view line) {
    const std::lock_guard lock(mutex);
    lines.append(line).append("\n");
  };
  asset_ = put_asset("manifest");
  stop();
  const auto kept = [&] {
    std::uint32_t end = 0;
    std::ifstream(folder_ + "/epoch") >> end;
    return end;
  };
  const std::uint32_t before = kept();
  fs::create_directory(folder_ + "/epoch.new");  // So that no file is written there.
  start();
  const auto ready = [&] { return http_request(admin_port_, "GET", "/readyz").body; };
  const std::string degraded = ready();
  EXPECT_TRUE(degraded.starts_with("ready, degraded: ")) << degraded;
  EXPECT_EQ(degraded.find(folder_), std::string::npos) << degraded;
  EXPECT_NE(http_request(admin_port_, "GET", "/api/broker").body.find("\"state\":\"degraded\""), std::string::npos);
  EXPECT_NE(http_request(admin_port_, "GET", "/metrics").body.find("\neigencast_broker_disk_failing 1\n"),
            std::string::npos);
  std::uint32_t last = 0;
  for (int i = 0; i < 100; ++i) {
    auto publisher = sender("a");  // The first one, and ones that return.
    ASSERT_GT(announced_.epoch, last);
    last = announced_.epoch;
  }
  EXPECT_EQ(kept(), before) << "nothing was written";
  fs::remove(folder_ + "/epoch.new");
  while (ready() != "ready\n") std::this_thread::sleep_for(std::chrono::milliseconds(20));
  EXPECT_GT(kept(), last);
  stop();
  EXPECT_NE(lines.find(folder_ + "/epoch"), std::string::npos) << "the log names the file";
}

TEST_F(ServiceTest, ReadOnlyFolderDoesNotStopTheStart) {
  asset_ = put_asset("manifest");
  stop();
  fs::remove(folder_ + "/broker.lock");
  fs::create_directory(folder_ + "/broker.lock");
  start();
  const auto ready = [&] { return http_request(admin_port_, "GET", "/readyz").body; };
  EXPECT_TRUE(ready().starts_with("ready, degraded: "));
  const auto publisher = sender("a");
  EXPECT_GT(announced_.epoch, 0u);
  const auto refused = request("PUT", "/v1/assets/" + name_of_asset("more"), "more");
  EXPECT_EQ(refused.status, 507);
  EXPECT_EQ(refused.body.find(folder_), std::string::npos) << refused.body;
  fs::remove(folder_ + "/broker.lock");
  while (ready() != "ready\n") std::this_thread::sleep_for(std::chrono::milliseconds(20));
  put_asset("more");
  stop();
  std::ofstream(folder_ + "/file").close();
  config_.server.data_dir = folder_ + "/file/data";
  start();
  EXPECT_TRUE(ready().starts_with("ready, degraded: "));
}

TEST_F(ServiceTest, TornEpochFileDoesNotStopTheStart) {
  std::atomic<int> told = 0;
  log_ = [&](LogLevel, std::string_view line) {
    if (line.find(folder_ + "/epoch ") != std::string_view::npos) ++told;
  };
  int torn_files = 0;
  for (const char* torn : {"", "2", "nonsense"}) {
    sender("a");
    const std::uint32_t epoch = announced_.epoch;
    stop();
    std::ofstream(folder_ + "/epoch") << torn;
    start();
    EXPECT_EQ(told, ++torn_files) << torn;
    sender("a");
    EXPECT_GT(announced_.epoch, epoch) << torn;
    stop();
    fs::remove(folder_ + "/epoch");
    start();
  }
  EXPECT_EQ(told, torn_files) << "no file is no torn file";
  stop();
}

TEST_F(ServiceTest, ConnectionWatchesStreamsAndChangesProfile) {
  auto a = sender("a");
  auto b = sender("b");
  Client viewer(port_, "/v1/subscribe");
  viewer.send(control::Subscribe{"a", Profile{Profile::Rate::kRaw}});
  const auto info_a = viewer.wait_for<control::StreamInfo>();
  viewer.send(control::Subscribe{"b", Profile{Profile::Rate::kRaw}});
  const auto info_b = viewer.wait_for<control::StreamInfo>();
  FakeSender motion_a;
  FakeSender motion_b;
  a->send_frame(motion_a.next(0));
  EXPECT_EQ(viewer.next_frame()->envelope.stream_id, info_a.stream_id);
  b->send_frame(motion_b.next(0));
  EXPECT_EQ(viewer.next_frame()->envelope.stream_id, info_b.stream_id);
  viewer.send(control::Subscribe{"a", Profile{Profile::Rate::kRaw, 3, 1}});
  EXPECT_EQ(viewer.wait_for<control::StreamInfo>().profile.bands, 1);
  const FramePtr join = viewer.next_frame();
  EXPECT_EQ(join->envelope.kind, FrameKind::kJoin);
  EXPECT_EQ(join->envelope.bands, 1);
  viewer.send(control::Unsubscribe{"a"});
  viewer.send(control::Ping{1, 1});
  viewer.wait_for<control::Pong>();
  a->send_frame(motion_a.next(1));
  b->send_frame(motion_b.next(1));
  EXPECT_EQ(viewer.next_frame()->envelope.stream_id, info_b.stream_id);
  viewer.send(control::Unsubscribe{"a"});
  EXPECT_EQ(viewer.wait_for<control::ErrorMessage>().code, "not-found");
}

TEST_F(ServiceTest, StoppingSendsByeAndEpochsGrow) {
  auto publisher = sender("a");
  const std::uint32_t epoch = announced_.epoch;
  Client viewer(port_, "/v1/subscribe/a");
  viewer.wait_for<control::StreamInfo>();
  begin_to_stop();
  EXPECT_GT(viewer.wait_for<control::Bye>().retry_after_ms, 0u);
  EXPECT_EQ(viewer.close_code(), 1012);
  EXPECT_EQ(publisher->close_code(), 1012);
  stop();
  start();
  publisher = sender("a");
  EXPECT_GT(announced_.epoch, epoch);
}

TEST_F(ServiceTest, StoppingUnderLoadIsClean) {
  auto publisher = sender("a");
  Client viewer(port_, "/v1/subscribe/a");
  Wire upload(port_);
  upload.write("PUT /v1/assets/" + asset_ + " HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\r\nhalf");
  viewer.wait_for<control::StreamInfo>();
  begin_to_stop();
  begin_to_stop();
  stop();
  start();
  std::size_t left = 0;
  for (const auto& entry : fs::recursive_directory_iterator(folder_ + "/assets"))
    left += entry.is_regular_file() ? 1 : 0;
  EXPECT_EQ(left, 1u) << "the manifest, and nothing of the upload";
}

TEST_F(ServiceTest, FailingHandlerEndsOnlyItsConnection) {
  stop();
  std::atomic<int> thrown = 0;
  std::atomic<bool> logged = false;
  log_ = [&](LogLevel, std::string_view line) {
    if (line.find("no memory") == std::string_view::npos && line.find("'unlucky'") != std::string_view::npos &&
        thrown++ == 0)
      throw std::runtime_error("no memory");
    if (line.find("no memory") != std::string_view::npos) logged = true;
  };
  start();
  auto publisher = sender("a");
  Client viewer(port_, "/v1/subscribe/a?rate=raw");
  viewer.wait_for<control::StreamInfo>();
  Client unlucky(port_, "/v1/publish/unlucky");
  unlucky.close_code();
  Client again(port_, "/v1/publish/unlucky");
  again.send(control::Ping{7, 9});
  EXPECT_EQ(again.wait_for<control::Pong>().id, 7u) << "the name is free again";
  FakeSender motion;
  publisher->send_frame(motion.next(0));
  EXPECT_EQ(viewer.next_frame()->envelope.sequence, 0u);
  EXPECT_EQ(request("GET", "/v1/streams").status, 200);
  EXPECT_GE(thrown, 1);
  EXPECT_TRUE(logged);
  stop();
}

}  // namespace
}  // namespace eigencast::broker
