// SPDX-License-Identifier: MIT
//
// A whole broker of several event loops.
#include <gmock/gmock.h>

#include <algorithm>
#include <atomic>
#include <exception>
#include <nlohmann/json.hpp>
#include <set>
#include <thread>
#include <utility>
#include <vector>

#include "tests/unit/broker/service.h"

namespace eigencast::broker {
namespace {

using namespace testing;
using ::testing::HasSubstr;

/// The same with three event loops, which share the viewers.
class LoopsTest : public ServiceTest {
 protected:
  LoopsTest() {
    config_.server.threads = 3;
    config_.limits.max_control_bytes = 65'536;
  }
  std::unique_ptr<Client> viewer(const std::string& stream = "a") {
    auto client = std::make_unique<Client>(port_, "/v1/subscribe/" + stream + "?rate=raw");
    info_ = client->wait_for<control::StreamInfo>();
    return client;
  }
  std::vector<std::unique_ptr<Client>> viewers(int count) {
    std::vector<std::unique_ptr<Client>> all;
    for (int i = 0; i < count; ++i) all.push_back(viewer());
    return all;
  }
  std::string admin(const std::string& target, const std::string& method = "GET") {
    const Answer answer = http_request(admin_port_, method, target);
    return answer.status == 200 ? answer.body : std::to_string(answer.status);
  }
  nlohmann::json facts(const std::string& target) { return nlohmann::json::parse(admin(target)); }
  double metric(const std::string& name) {
    const std::string text = "\n" + admin("/metrics");
    const auto at = text.find("\n" + name + " ");
    return at == std::string::npos ? -1 : std::stod(text.substr(at + name.size() + 2));
  }
  static std::uint32_t wait_for_count(Client& publisher, std::uint32_t count) {
    for (;;) {
      const auto reported = publisher.wait_for<control::Subscribers>().count;
      if (reported == count || publisher.failed()) return reported;
    }
  }

  control::StreamInfo info_;
};

TEST_F(LoopsTest, ViewersOfAllLoopsSeeOneStream) {
  auto early = viewer();
  EXPECT_EQ(info_.state, control::StreamInfo::State::kWaiting);
  auto publisher = sender("a");
  EXPECT_EQ(early->wait_for<control::StreamInfo>().epoch, announced_.epoch);
  auto all = viewers(8);
  all.push_back(std::move(early));
  EXPECT_EQ(info_.stream_id, announced_.stream_id);
  EXPECT_EQ(wait_for_count(*publisher, 9), 9u);
  EXPECT_THAT(request("GET", "/v1/streams").body, HasSubstr("\"subscribers\":9"));
  for (const char* thread : {"0", "1", "2"}) {
    EXPECT_GE(metric("eigencast_broker_loop_connections{loop=\"" + std::string(thread) + "\"}"), 3) << thread;
  }
  ASSERT_EQ(admin("/api/recordings/start?stream=a", "POST"), "{}\n");
  FakeSender motion;
  std::vector<FakeReceiver> receivers(all.size());
  for (int i = 0; i < 20; ++i) {
    publisher->send_frame(motion.next(i * 33'000));
    for (std::size_t v = 0; v < all.size(); ++v) {
      receivers[v].decode(*all[v]->next_frame());
      ASSERT_EQ(receivers[v].undecodable, 0);
      ASSERT_EQ(receivers[v].poses.back().key, key_number(i)) << "viewer " << v;
    }
  }
  const auto broker = facts("/api/broker");
  EXPECT_EQ(broker["threads"], 3);
  EXPECT_EQ(broker["frames_sent"], 20 * 9);
  EXPECT_EQ(metric("eigencast_broker_frames_sent_total"), 20 * 9);
  EXPECT_EQ(metric("eigencast_broker_subscriptions"), 9);
  const auto stream = facts("/api/streams")["streams"][0];
  EXPECT_EQ(stream["viewers"], 9);
  EXPECT_EQ(stream["keys_received"], 20);
  EXPECT_EQ(stream["profiles"], 3) << "each loop has its own feed";
  EXPECT_EQ(admin("/api/recordings/stop?stream=a", "POST"), "{}\n");
  auto recordings = facts("/api/recordings")["recordings"];
  while (recordings.empty() || recordings[0]["state"] != "finished") {  // The disk's thread is asynchronous.
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
    recordings = facts("/api/recordings")["recordings"];
  }
  EXPECT_EQ(recordings[0]["frames_dropped"], 0);
  EXPECT_GE(recordings[0]["frames"], 19) << "the first may be the checkpoint alone";

  auto late = viewer();
  EXPECT_EQ(late->next_frame()->envelope.sequence, 19u) << "the present pose";
  publisher.reset();
  for (const auto& one : all) {
    EXPECT_EQ(one->wait_for<control::StreamInfo>().state, control::StreamInfo::State::kStalled);
  }
  publisher = sender("a");
  for (const auto& one : all) EXPECT_EQ(one->wait_for<control::StreamInfo>().epoch, announced_.epoch);
  EXPECT_EQ(wait_for_count(*publisher, 10), 10u);
  all.clear();
  late.reset();
  EXPECT_EQ(wait_for_count(*publisher, 0), 0u);
}

TEST_F(LoopsTest, SecondSenderIsRefusedOrReplacesFirst) {
  auto first = sender("a");
  auto all = viewers(3);
  Client second(port_, "/v1/publish/a");
  second.send(small_announce());
  EXPECT_EQ(second.wait_for<control::ErrorMessage>().code, "refused");
  EXPECT_EQ(second.close_code(), 1008);
  stop();
  config_.streams.second_sender = "replace";
  start();
  first = sender("a");
  all = viewers(3);
  auto third = sender("a");
  EXPECT_EQ(first->close_code(), 4409);
  for (const auto& one : all) {
    control::StreamInfo info;
    do {
      info = one->wait_for<control::StreamInfo>();
    } while (info.epoch != announced_.epoch && !one->failed());
    EXPECT_EQ(info.state, control::StreamInfo::State::kLive);
  }
}

TEST_F(LoopsTest, OperatorListsAndKicksClientsOfAllLoops) {
  auto publisher = sender("a");
  auto all = viewers(5);
  const auto clients = facts("/api/clients")["clients"];
  ASSERT_EQ(clients.size(), 6u);
  EXPECT_EQ(clients[0]["kind"], "sender");
  for (std::size_t i = 1; i < clients.size(); ++i) {
    EXPECT_LT(clients[i - 1]["id"], clients[i]["id"]);
    EXPECT_EQ(clients[i]["streams"][0]["stream"], "a");
  }
  const auto kick = [&](std::uint64_t id) { return admin("/api/clients/kick?id=" + std::to_string(id), "POST"); };
  for (std::size_t i = 1; i < clients.size(); ++i) {
    EXPECT_EQ(kick(clients[i]["id"].get<std::uint64_t>()), "{}\n");
    EXPECT_EQ(all[i - 1]->close_code(), 1008) << "only the client of that id";
  }
  EXPECT_EQ(kick(clients[1]["id"].get<std::uint64_t>()), "404");
  EXPECT_EQ(metric("eigencast_broker_kicked_total"), 5);
  EXPECT_EQ(wait_for_count(*publisher, 0), 0u);
}

TEST_F(LoopsTest, OperatorSeesClientsAPageAtATime) {
  constexpr std::size_t kClients = 120, kPage = 50;
  std::vector<std::unique_ptr<Client>> all;
  for (std::size_t i = 0; i < kClients; ++i) all.push_back(std::make_unique<Client>(port_, "/v1/subscribe"));
  for (int i = 0; i < 20; ++i) all.front()->send(control::Subscribe{"s" + std::to_string(i), Profile{}});
  for (int i = 0; i < 20; ++i) (void)all.front()->wait_for<control::StreamInfo>();
  std::vector<std::size_t> sizes;
  std::vector<std::uint64_t> ids;
  std::string after;
  do {
    const auto page = facts("/api/clients" + after);
    EXPECT_EQ(page["total"], kClients);
    ASSERT_LE(page["clients"].size(), kPage);
    sizes.push_back(page["clients"].size());
    for (const auto& client : page["clients"]) ids.push_back(client["id"]);
    if (after.empty()) {
      EXPECT_EQ(page["clients"][0]["streams"].size(), 8u);
      EXPECT_EQ(page["clients"][0]["stream_count"], 20);
    }
    after = page.contains("next") ? "?after=" + page["next"].dump() : "";
  } while (!after.empty());
  EXPECT_EQ(sizes, (std::vector<std::size_t>{kPage, kPage, kClients - 2 * kPage}));
  EXPECT_TRUE(std::is_sorted(ids.begin(), ids.end()));
  EXPECT_EQ(std::set(ids.begin(), ids.end()).size(), kClients) << "each once";
  const auto beyond = facts("/api/clients?after=" + std::to_string(ids.back()));
  EXPECT_TRUE(beyond["clients"].empty());
  EXPECT_EQ(beyond["total"], kClients);
  for (const char* wrong : {"x", "-1", "1x", "99999999999999999999"}) {
    EXPECT_EQ(admin("/api/clients?after=" + std::string(wrong)), "400") << wrong;
  }
}

TEST_F(LoopsTest, OperatorSeesStreamsAPageAtATime) {
  constexpr std::size_t kStreams = 250, kPage = 100;
  Client viewer(port_, "/v1/subscribe");
  for (std::size_t i = 0; i < kStreams; ++i) viewer.send(control::Subscribe{"of/s" + std::to_string(i), Profile{}});
  for (std::size_t i = 0; i < kStreams; ++i) (void)viewer.wait_for<control::StreamInfo>();
  std::vector<std::size_t> sizes;
  std::vector<std::string> names;
  std::string after;
  do {
    const auto page = facts("/api/streams" + after);
    EXPECT_EQ(page["total"], kStreams);
    sizes.push_back(page["streams"].size());
    for (const auto& stream : page["streams"]) {
      names.push_back(stream["stream"]);
      EXPECT_EQ(stream["viewers"], 1);
    }
    after = page.contains("next") ? "?after=" + page["next"].get<std::string>() : "";
  } while (!after.empty());
  EXPECT_EQ(sizes, (std::vector<std::size_t>{kPage, kPage, kStreams - 2 * kPage}));
  EXPECT_TRUE(std::is_sorted(names.begin(), names.end()));
  EXPECT_EQ(std::set(names.begin(), names.end()).size(), kStreams) << "each once";
}

TEST_F(LoopsTest, LimitsCountAcrossLoops) {
  stop();
  config_.limits.max_subscribers_per_stream = 4;
  config_.limits.max_waiting_streams = 1;
  config_.limits.max_connections = 8;
  config_.per_address.streams = 6;
  start();
  auto publisher = sender("a");
  auto all = viewers(4);
  Client fifth(port_, "/v1/subscribe/a");
  EXPECT_EQ(fifth.wait_for<control::ErrorMessage>().code, "too-large");
  fifth.send(control::Subscribe{"b", Profile{}});
  EXPECT_EQ(fifth.wait_for<control::StreamInfo>().stream, "b");
  Client sixth(port_, "/v1/subscribe/c");
  EXPECT_EQ(sixth.wait_for<control::ErrorMessage>().code, "too-large");
  all.pop_back();
  EXPECT_EQ(wait_for_count(*publisher, 3), 3u);
  fifth.send(control::Subscribe{"a", Profile{}});
  EXPECT_EQ(fifth.wait_for<control::StreamInfo>().epoch, announced_.epoch) << "there is room again";
  EXPECT_EQ(facts("/api/broker")["connections"], 6);
  EXPECT_EQ(metric("eigencast_broker_connections_max"), 8);
  std::vector<std::unique_ptr<Client>> more;
  for (int i = 0; i < 2; ++i) more.push_back(std::make_unique<Client>(port_, "/v1/subscribe"));
  EXPECT_EQ(request("GET", "/v1/streams").status, 503);
}

TEST_F(LoopsTest, StoppingSendsByeInEveryLoop) {
  auto publisher = sender("a");
  auto all = viewers(6);
  begin_to_stop();
  for (const auto& one : all) {
    EXPECT_GT(one->wait_for<control::Bye>().retry_after_ms, 0u);
    EXPECT_EQ(one->close_code(), 1012);
  }
  EXPECT_EQ(publisher->close_code(), 1012);
  stop();
}

TEST_F(LoopsTest, UploadCompletesWhileStopping) {
  const std::string content(50'000, 'x');
  Wire upload(port_);
  upload.write("PUT /v1/assets/" + name_of_asset(content) +
               " HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Length: 50000\r\n\r\n" +
               content.substr(0, 20'000));
  while (metric("eigencast_broker_uploads") != 1) std::this_thread::sleep_for(std::chrono::milliseconds(2));
  begin_to_stop();
  upload.write(content.substr(20'000));
  EXPECT_THAT(upload.read_all().value_or("broken off"), HasSubstr("HTTP/1.1 201 Created"));
  stop();
}

TEST_F(LoopsTest, ConnectsAndDisconnectsWhileStopping) {
  auto publisher = sender("a");
  std::atomic<bool> over = false;
  std::vector<std::thread> crowd;
  for (int i = 0; i < 4; ++i) {
    crowd.emplace_back([&, port = port_] {
      while (!over) {
        try {
          Client client(port, "/v1/subscribe");
          if (client.failed()) continue;
          client.send(control::Subscribe{"a", Profile{}});
          client.send(control::Subscribe{"nobody", Profile{}});
          if (client.read()) client.send(control::Unsubscribe{"a"});
        } catch (const std::exception&) {  // The broker has stopped listening.
        }
      }
    });
  }
  FakeSender motion;
  for (int i = 0; i < 100; ++i) {
    publisher->send_frame(motion.next(i * 2'000));
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  EXPECT_FALSE(publisher->failed());
  begin_to_stop();
  stop();
  over = true;
  for (std::thread& one : crowd) one.join();
}

}  // namespace
}  // namespace eigencast::broker
