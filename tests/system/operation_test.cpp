// SPDX-License-Identifier: MIT
// The broker as a service: what it reports, what it is asked, and what it says to the service manager.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <regex>
#include <set>
#include <sstream>

#include "common/recording/reader.h"
#include "common/wire/link_bytes.h"
#include "tests/support/paths.h"
#include "tests/system/operation.h"

namespace eigencast::testing {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;
using ::testing::Not;

TEST_F(Operation, TheAdminApiReportsHealthAndMetrics) {
  const auto broker = scene_.start_broker();
  const auto sender = scene_.start_sender({"torus", "--rate", "30"});
  const auto client = scene_.start_client("a", {"--frames", "1000000"});
  ASSERT_TRUE(live()) << scene_.logs();
  EXPECT_THAT(get("/livez"), HasSubstr("200 OK"));
  EXPECT_THAT(get("/readyz"), HasSubstr("200 OK"));
  EXPECT_THAT(get("/version"), HasSubstr("eigencast-broker "));
  EXPECT_THAT(get("/nothing"), HasSubstr("404"));
  ASSERT_TRUE(eventually([&] { return api("streams")["streams"][0]["viewers"] == 1; }, kPatience));
  const json stream = api("streams")["streams"][0];
  EXPECT_EQ(stream["stream"], "live/test");
  EXPECT_EQ(stream["state"], "live");
  ASSERT_EQ(api("clients")["clients"].size(), 2u) << api("clients").dump();
  EXPECT_EQ(client_of_kind("sender")["streams"][0]["stream"], "live/test");
  ASSERT_TRUE(eventually([&] { return client_of_kind("viewer")["round_trip_ms"].is_number(); }, kPatience));
  EXPECT_GT(metric("eigencast_broker_frames_sent_total"), 0);
  EXPECT_GT(metric("eigencast_broker_frame_delay_seconds_count"), 0);
  EXPECT_GT(metric("eigencast_broker_frame_bytes_received_total{predicted_from=\"keys\"}"), 0);
  EXPECT_EQ(metric("eigencast_broker_frame_link_bytes{layer=\"tls\"}"), link_bytes(1, 1).tls);
  EXPECT_GT(metric("process_resident_memory_bytes"), 1e6);
  const std::string page = get("/");
  EXPECT_THAT(page, HasSubstr("Content-Security-Policy: default-src 'none'"));
  EXPECT_THAT(page, Not(HasSubstr("NONCE")));
  EXPECT_FALSE(std::regex_search(body_of(page), std::regex("(src|href)="))) << "nothing is fetched from elsewhere";

  const std::string viewer = client_of_kind("viewer")["id"].dump();
  EXPECT_THAT(get("/api/clients/kick?id=" + viewer), HasSubstr("404")) << "orders are POSTs";
  EXPECT_THAT(post("/api/clients/kick?id=" + viewer), HasSubstr("200"));
  EXPECT_TRUE(eventually([&] { return client_of_kind("viewer")["id"].dump() != viewer; }, kPatience)) << scene_.logs();
  EXPECT_THAT(post("/api/clients/kick?id=" + viewer), HasSubstr("404"));
  EXPECT_EQ(metric("eigencast_broker_kicked_total"), 1);
}

TEST_F(Operation, TheStatusPageShowsStreamsAndClients) {
  const auto broker = scene_.start_broker();
  const auto sender = scene_.start_sender({"torus", "--rate", "30"});
  const auto client = scene_.start_client("a", {"--frames", "1000000"});
  ASSERT_TRUE(live()) << scene_.logs();
  ASSERT_TRUE(eventually([&] { return api("clients")["clients"].size() == 2; }, kPatience)) << scene_.logs();
  const std::string node = EIGENCAST_NODE;
  if (node.empty()) GTEST_SKIP() << "no node to run the page's script";
  ASSERT_EQ(scene_.run("page", {node, EIGENCAST_STATUS_PAGE_READER, "http://127.0.0.1:" + scene_.admin_port() + "/"}),
            0)
      << scene_.logs();
  std::ifstream in(scene_.file("page.log"));
  const json page = json::parse(in, nullptr, false);
  ASSERT_EQ(page["streams"].size(), 1u) << page.dump();
  EXPECT_EQ(page["streams"][0][0], "live/test");
  EXPECT_EQ(page["streams"][0][1], "live");
  EXPECT_GT(std::stod(page["streams"][0][3].get<std::string>()), 0) << "keys a second";
  ASSERT_EQ(page["clients"].size(), 2u) << page.dump();
  std::set<std::string> kinds;
  for (const json& row : page["clients"]) {
    kinds.insert(row[1].get<std::string>());
    EXPECT_THAT(row[3].get<std::string>(), HasSubstr("live/test"));
  }
  EXPECT_EQ(kinds, (std::set<std::string>{"sender", "viewer"}));
  EXPECT_THAT(page["clients-shown"].get<std::string>(), HasSubstr("2 of 2"));
  EXPECT_TRUE(std::regex_search(page["note"].get<std::string>(), std::regex("[0-9]+ connections"))) << page["note"];
}

TEST_F(Operation, TheManualNamesEveryMetric) {
  const auto broker = scene_.start_broker();
  const std::string text = body_of(get("/metrics"));
  std::ifstream in(EIGENCAST_OPERATIONS_MANUAL);
  ASSERT_TRUE(in);
  std::ostringstream manual;
  manual << in.rdbuf();
  std::set<std::string> served, documented;
  const std::regex type("# TYPE ([a-z_]+) ");
  for (std::sregex_iterator it(text.begin(), text.end(), type), end; it != end; ++it) served.insert((*it)[1]);
  const std::string page = manual.str();
  const std::regex name("`((eigencast_broker|process)_[a-z_]+)");
  for (std::sregex_iterator it(page.begin(), page.end(), name), end; it != end; ++it) documented.insert((*it)[1]);
  EXPECT_EQ(served, documented);
  for (const char* path : {"/livez", "/readyz", "/version", "/metrics", "/api/broker", "/api/streams", "/api/clients",
                           "/api/recordings"}) {
    EXPECT_THAT(page, HasSubstr("`GET " + std::string(path) + "`"));
    EXPECT_THAT(get(path), HasSubstr("200 OK")) << path;
  }
  const std::regex order("`POST (/api/[a-z/]+)");
  std::set<std::string> orders;
  for (std::sregex_iterator it(page.begin(), page.end(), order), end; it != end; ++it) orders.insert((*it)[1]);
  EXPECT_EQ(orders.size(), 4u);
  orders.erase("/api/drain");  // It would be obeyed.
  for (const std::string& path : orders) EXPECT_THAT(post(path), Not(HasSubstr("see POST"))) << path;
}

TEST_F(Operation, PromtoolAcceptsTheMetrics) {
  if (!on_path("promtool")) GTEST_SKIP() << "no promtool (Debian: prometheus)";
  const auto broker = scene_.start_broker();
  std::ofstream(scene_.file("metrics.txt")) << body_of(get("/metrics"));
  const std::string command = "promtool check metrics <" + scene_.file("metrics.txt");
  EXPECT_EQ(scene_.run("promtool", {"/bin/sh", "-c", command}), 0) << scene_.logs();
}

TEST_F(Operation, ARecordingSurvivesSigkillAndReplays) {
  auto broker = scene_.start_broker({"--recording-include-asset"});
  auto sender = scene_.start_sender({"torus", "--rate", "30"});
  ASSERT_TRUE(live()) << scene_.logs();
  EXPECT_THAT(post("/api/recordings/start?stream=live/test"), HasSubstr("200"));
  EXPECT_THAT(post("/api/recordings/start?stream=live/test"), HasSubstr("409"));
  const double before = metric("eigencast_broker_frames_received_total");
  ASSERT_TRUE(eventually([&] { return api("recordings")["recordings"][0]["frames"] > 60; }, kPatience))
      << scene_.logs();
  const auto frames = api("recordings")["recordings"][0]["frames"].get<std::uint64_t>();
  const double received = metric("eigencast_broker_frames_received_total") - before;
  kill(*broker);
  kill(*sender);
  ASSERT_EQ(recordings().size(), 1u);
  const std::string file = recordings()[0];
  {
    const auto torn = recording::Reader::open(file);
    ASSERT_TRUE(torn) << torn.error().message;
    EXPECT_FALSE(torn->info().complete);
    EXPECT_GE(torn->info().frames, frames);
    EXPECT_GE(static_cast<double>(torn->info().frames), received - 30) << "at most the last second is lost";
  }
  broker = scene_.start_broker();
  EXPECT_TRUE(eventually(
      [&] {
        const auto repaired = recording::Reader::open(file);
        return repaired && repaired->info().complete;
      },
      kPatience))
      << scene_.logs();

  // A broker that has never seen the asset.
  Scene other;
  const auto fresh = other.start_broker();
  const auto viewer = other.start_client("a", {"--frames", "30", "--rate", "raw"});
  {
    Process replay({bin_dir() + "/eigencast-sender", "replay", file, "--to", other.url(), "--speed", "2", "--loop"},
                   other.file("replay.log"));
    EXPECT_EQ(viewer->wait(kPatience), 0) << other.logs();
    replay.signal(SIGTERM);
    EXPECT_EQ(replay.wait(kPatience), 0) << other.logs();
  }
  EXPECT_EQ(
      other.run("late", {"eigencast-sender", "replay", file, "--to", other.url(), "--from", "1", "--duration", "0.5"}),
      0)
      << other.logs();
}

TEST_F(Operation, ASecondSenderReplacesTheFirst) {
  const auto broker = scene_.start_broker({"--streams-second-sender", "replace"});
  const auto first = scene_.start_sender({"torus", "--rate", "30"});
  ASSERT_TRUE(live()) << scene_.logs();
  const auto second = std::make_unique<Process>(
      std::vector<std::string>{bin_dir() + "/eigencast-sender", "play", "torus", "--rate", "30", "--to", scene_.url()},
      scene_.file("second.log"));
  EXPECT_EQ(first->wait(kPatience), 4) << "it does not come back: " << scene_.logs();
  EXPECT_TRUE(live()) << scene_.logs();
  EXPECT_TRUE(second->running()) << scene_.logs();
  EXPECT_EQ(metric("eigencast_broker_senders_replaced_total"), 1) << scene_.logs();
}

TEST_F(Operation, OnSigtermItEndsAndPeersComeBack) {
  auto broker = scene_.start_broker();
  const auto sender = scene_.start_sender({"torus", "--rate", "30"});
  ASSERT_TRUE(live()) << scene_.logs();
  broker->signal(SIGTERM);
  EXPECT_EQ(broker->wait(kPatience), 0) << scene_.logs();
  broker = scene_.start_broker();
  EXPECT_TRUE(live()) << scene_.logs();
  EXPECT_TRUE(sender->running()) << scene_.logs();
}

TEST_F(Operation, ADrainIsNotReadyAndEndsAtItsDeadline) {
  const auto broker = scene_.start_broker({"--timeouts-shutdown-ms", "10000"});
  const int stays = upgrade(scene_.port(), "/v1/subscribe/a");  // Never answers the close.
  ASSERT_GE(stays, 0) << scene_.logs();
  EXPECT_THAT(get("/readyz"), HasSubstr("200 OK"));
  EXPECT_THAT(post("/api/drain"), HasSubstr("200"));
  EXPECT_TRUE(eventually([&] { return get("/readyz").find("503") != std::string::npos; }, kPatience)) << scene_.logs();
  EXPECT_THAT(get("/livez"), HasSubstr("200 OK"));
  EXPECT_EQ(metric("eigencast_broker_draining"), 1);
  EXPECT_EQ(connect_to(scene_.port()), -1) << "no new peers";
  std::string notice;
  char buffer[4096];
  for (ssize_t count = 0; (count = ::recv(stays, buffer, sizeof buffer, 0)) > 0;) {
    notice.append(buffer, static_cast<std::size_t>(count));
  }
  EXPECT_THAT(notice, HasSubstr("retry_after_ms"));
  EXPECT_EQ(broker->wait(kPatience), 0) << scene_.logs();
  ::close(stays);
}

TEST_F(Operation, TheServiceManagerHearsReadyAliveAndStopping) {
  const std::string path = scene_.file("notify");
  const int fd = ::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  ASSERT_LT(path.size(), sizeof address.sun_path);
  path.copy(address.sun_path, path.size());
  ASSERT_EQ(::bind(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
  const timeval patience{60, 0};
  ::setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
  const auto wait_for = [&](const std::string& text) {
    char buffer[512];
    for (ssize_t count = 0; (count = ::recv(fd, buffer, sizeof buffer, 0)) > 0;) {
      if (std::string(buffer, static_cast<std::size_t>(count)).find(text) != std::string::npos) return true;
    }
    return false;
  };
  const auto broker = scene_.start_broker({}, {"/usr/bin/env", "NOTIFY_SOCKET=" + path, "WATCHDOG_USEC=300000"});
  EXPECT_TRUE(wait_for("READY=1"));
  EXPECT_TRUE(wait_for("WATCHDOG=1"));
  EXPECT_TRUE(wait_for("WATCHDOG=1"));
  broker->signal(SIGHUP);
  EXPECT_TRUE(wait_for("RELOADING=1"));
  EXPECT_TRUE(wait_for("READY=1"));
  broker->signal(SIGTERM);
  EXPECT_TRUE(wait_for("STOPPING=1"));
  EXPECT_EQ(broker->wait(kPatience), 0);
  ::close(fd);
}

TEST_F(Operation, AnInheritedSocketIsUsed) {
  if (!on_path("systemd-socket-activate")) GTEST_SKIP() << "no systemd-socket-activate";
  // Any port that is free just now.
  const int probe = ::socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof address;
  ASSERT_EQ(::bind(probe, reinterpret_cast<const sockaddr*>(&address), size), 0);
  ASSERT_EQ(::getsockname(probe, reinterpret_cast<sockaddr*>(&address), &size), 0);
  const std::string port = std::to_string(ntohs(address.sin_port));
  ::close(probe);
  Process broker({"systemd-socket-activate", "--listen=127.0.0.1:" + port, "--fdname=data",
                  bin_dir() + "/eigencast-broker", "--listen", "127.0.0.1:0", "--data-dir", scene_.file("data")},
                 scene_.file("activated.log"));
  std::string answer;
  EXPECT_TRUE(eventually([&] { return !(answer = ask(port, "GET", "/v1/streams")).empty(); }, kPatience))
      << broker.output();
  EXPECT_THAT(answer, HasSubstr("\"streams\":[]")) << broker.output();
}

}  // namespace
}  // namespace eigencast::testing
