// SPDX-License-Identifier: MIT
// What goes wrong around a broker: nothing crashes, the others go on, the log says what happened. That each of the
// three programs may be killed is in restart_test.cpp.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <fstream>
#include <random>

#include "common/core/hash/sha256.h"
#include "common/recording/reader.h"
#include "tests/support/paths.h"
#include "tests/system/operation.h"

namespace eigencast::testing {
namespace {

using ::testing::HasSubstr;

class Fault : public Operation {
 protected:
  void start(std::vector<std::string> more = {}, std::vector<std::string> wrapper = {}) {
    broker_ = scene_.start_broker(std::move(more), std::move(wrapper));
    sender_ = scene_.start_sender({"torus", "--rate", "30"});
    client_ = scene_.start_client("a", kEndless);
    ASSERT_TRUE(grows("a")) << scene_.logs();
  }
  /// No file of the broker may grow beyond so many bytes, which to it is a full disk.
  void limit_files(rlim_t bytes) const {
    rlimit limit{};
    ASSERT_EQ(::prlimit(broker_->pid(), RLIMIT_FSIZE, nullptr, &limit), 0);
    limit.rlim_cur = bytes;
    ASSERT_EQ(::prlimit(broker_->pid(), RLIMIT_FSIZE, &limit, nullptr), 0);
  }

  std::unique_ptr<Process> broker_, sender_, client_;
};

TEST_F(Fault, WithoutDescriptorsItWaitsAndLogs) {
#if defined(__SANITIZE_ADDRESS__)
  GTEST_SKIP() << "UBSan tries memory by writing it to a pipe, and takes it for bad where it can have none";
#endif
  start({}, {"/bin/bash", "-c", "ulimit -n 48; exec \"$@\"", "bash"});
  std::vector<int> sockets;
  for (int i = 0; i < 80; ++i) sockets.push_back(connect_to(scene_.port()));
  EXPECT_TRUE(broker_->wait_for_output("ulimit -n", kPatience)) << scene_.logs();
  EXPECT_TRUE(grows("a")) << scene_.logs();
  for (const int fd : sockets) ::close(fd);
  EXPECT_TRUE(eventually([&] { return get("/livez").find("200 OK") != std::string::npos; }, kPatience))
      << scene_.logs();
  EXPECT_EQ(api("clients")["clients"].size(), 2u) << "the clients stayed";
}

TEST_F(Fault, AFullDiskRefusesUploads) {
  const auto broker = scene_.start_broker({}, {"/bin/bash", "-c", "ulimit -f 8; exec \"$@\"", "bash"});
  const auto sender = scene_.start_sender({"torus", "--rate", "30"});
  EXPECT_TRUE(eventually([&] { return metric("eigencast_broker_uploads_failed_total") > 0; }, kPatience))
      << scene_.logs();
  EXPECT_TRUE(sender->wait_for_output("507", kPatience)) << scene_.logs();
  EXPECT_THAT(get("/livez"), HasSubstr("200 OK")) << scene_.logs();
  EXPECT_EQ(metric("eigencast_broker_asset_bytes"), 0) << "nothing is left of what failed";
}

TEST_F(Fault, AFullDiskEndsOnlyTheRecording) {
  start();
  limit_files(6'000);
  EXPECT_THAT(post("/api/recordings/start?stream=live/test"), HasSubstr("200"));
  ASSERT_TRUE(eventually([&] { return metric("eigencast_broker_recordings_failed_total") == 1; }, kPatience))
      << scene_.logs();
  EXPECT_TRUE(broker_->wait_for_output("recordings/", kPatience)) << "the log names the file";
  EXPECT_TRUE(grows("a")) << scene_.logs();
  ASSERT_EQ(recordings().size(), 1u);
  const auto whole = recording::Reader::open(recordings()[0]);
  ASSERT_TRUE(whole) << whole.error().message;
  EXPECT_GT(whole->info().frames, 0u);
  EXPECT_EQ(whole->info().torn_bytes, 0u) << "it ends at a record's border";

  limit_files(RLIM_INFINITY);
  EXPECT_THAT(post("/api/recordings/start?stream=live/test"), HasSubstr("200")) << "with room again, it records again";
  EXPECT_TRUE(eventually([&] { return api("recordings")["recordings"][0]["frames"] > 10; }, kPatience))
      << scene_.logs();
}

TEST_F(Fault, GarbageEndsItsConnectionOnly) {
  start();
  std::mt19937 random(1);
  for (int i = 0; i < 20; ++i) {
    const int fd = upgrade(scene_.port(), i % 2 == 0 ? "/v1/publish/other" : "/v1/subscribe/live/test");
    ASSERT_GE(fd, 0) << scene_.logs();
    std::string garbage;
    for (int n = 0; n < 5000; ++n) garbage += static_cast<char>(random());
    if (i % 4 < 2) garbage = "\x82\xfe\x13\x88" + std::string(4, '\0') + garbage;  // A whole binary message.
    send_all(fd, garbage);
    ::shutdown(fd, SHUT_WR);
    char buffer[4096];
    while (::recv(fd, buffer, sizeof buffer, 0) > 0) {
    }
    ::close(fd);
  }
  EXPECT_TRUE(eventually([&] { return api("clients")["clients"].size() == 2; }, kPatience)) << scene_.logs();
  EXPECT_TRUE(grows("a")) << scene_.logs();
  EXPECT_EQ(scene_.reconnects("a", *client_), 0u) << scene_.logs();
}

TEST_F(Fault, OnlyAFloodingSenderIsDisconnected) {
  start({"--per-address-messages-per-s", "1500"});  // Fewer than limits.control_messages_per_s.
  const int fd = upgrade(scene_.port(), "/v1/publish/flood", "127.0.0.2");
  ASSERT_GE(fd, 0) << scene_.logs();
  // Without a question among them, so that it is not for the answers that it does not read.
  std::string flood;
  for (int i = 0; i < 3000; ++i) flood += websocket_text(R"({"op":"pong","id":1,"time_us":2,"peer_time_us":3})");
  EXPECT_TRUE(eventually(
      [&] {
        send_all(fd, flood);
        return broker_->output().find("per_address.messages_per_s = 1500") != std::string::npos;
      },
      kPatience))
      << scene_.logs();
  ::close(fd);
  // Fast, but allowed: what no viewer can take is skipped, not queued.
  const Process fast({bin_dir() + "/eigencast-sender", "play", "torus", "--rate", "1000", "--to",
                      "ws://127.0.0.1:" + scene_.port() + "/live/fast"},
                     scene_.file("fast.log"));
  EXPECT_TRUE(eventually([&] { return metric("eigencast_broker_frames_received_total") > 2000; }, kPatience))
      << scene_.logs();
  EXPECT_TRUE(grows("a")) << scene_.logs();
  EXPECT_EQ(scene_.reconnects("a", *client_), 0u) << scene_.logs();
}

TEST_F(Fault, ABurstOfQuestionsIsAnswered) {
  start();
  const int fd = upgrade(scene_.port(), "/v1/subscribe");
  ASSERT_GE(fd, 0) << scene_.logs();
  // Five times what may wait for one connection, in one piece: one turn of the broker's loop reads it all.
  constexpr int kQuestions = 1280;
  std::string questions;
  for (int i = 0; i < kQuestions; ++i) questions += websocket_text(R"({"op":"ping","id":1,"time_us":2})");
  send_all(fd, questions);
  const std::string answer = R"("op":"pong")";
  std::string text;
  const auto answers = [&] {
    int count = 0;
    for (auto at = text.find(answer); at != std::string::npos; at = text.find(answer, at + 1)) ++count;
    return count;
  };
  char buffer[65536];
  for (ssize_t count = 0; answers() < kQuestions && (count = ::recv(fd, buffer, sizeof buffer, 0)) > 0;) {
    text.append(buffer, static_cast<std::size_t>(count));
  }
  EXPECT_EQ(answers(), kQuestions) << scene_.logs();
  EXPECT_EQ(metric("eigencast_broker_slow_disconnects_total"), 0);
  ::close(fd);
}

TEST_F(Fault, AStoppedSenderIsCutOffAndResumes) {
  start({"--timeouts-idle-ms", "3000"});
  sender_->signal(SIGSTOP);
  EXPECT_TRUE(client_->wait_for_output("stalled", kPatience)) << scene_.logs();
  EXPECT_TRUE(broker_->wait_for_output("timeouts.idle_ms", kPatience)) << scene_.logs();
  EXPECT_EQ(api("streams")["streams"][0]["state"], "stalled");
  EXPECT_TRUE(broker_->running());
  sender_->signal(SIGCONT);
  EXPECT_TRUE(grows("a")) << scene_.logs();
}

TEST_F(Fault, ClockJumpsDisturbNothing) {
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  GTEST_SKIP() << "a sanitizer wants to be loaded before the clock";
#endif
  const std::string step = scene_.file("step");
  const auto jump = [&](std::int64_t seconds) {
    std::ofstream(step, std::ios::in | std::ios::out | std::ios::binary)
        .write(reinterpret_cast<const char*>(&seconds), sizeof seconds);
  };
  std::ofstream(step, std::ios::binary) << std::string(sizeof(std::int64_t), '\0');
  ::setenv("EIGENCAST_TEST_CLOCK", step.c_str(), 1);
  ::setenv("LD_PRELOAD", EIGENCAST_STEPPED_CLOCK, 1);
  start({"--log-format", "json"});
  ::unsetenv("LD_PRELOAD");
  for (const std::int64_t seconds : {100'000'000, -100'000'000, 0}) {
    jump(seconds);
    EXPECT_TRUE(grows("a")) << seconds << scene_.logs();
    EXPECT_THAT(post("/api/recordings/start?stream=live/test"), HasSubstr("200")) << scene_.logs();
    EXPECT_TRUE(eventually([&] { return api("recordings")["recordings"][0]["frames"] > 10; }, kPatience));
    EXPECT_THAT(post("/api/recordings/stop?stream=live/test"), HasSubstr("200")) << scene_.logs();
  }
  jump(-100'000'000);
  broker_->signal(SIGHUP);
  const auto year = [](std::int64_t from_now) {
    const std::time_t then = std::time(nullptr) + from_now;
    return std::to_string(1900 + std::gmtime(&then)->tm_year);
  };
  EXPECT_TRUE(broker_->wait_for_output("{\"time\":\"" + year(-100'000'000), kPatience)) << "the clock did jump";
  // A newer presence of the sender is newer whatever the clock says.
  const auto epoch = api("streams")["streams"][0]["epoch"].get<std::uint64_t>();
  kill(*sender_);
  sender_ = scene_.start_sender({"torus", "--rate", "30"});
  EXPECT_TRUE(grows("a")) << scene_.logs();
  EXPECT_GT(api("streams")["streams"][0]["epoch"].get<std::uint64_t>(), epoch);
  for (const std::string& file : recordings()) {
    const auto played = recording::Reader::open(file);
    ASSERT_TRUE(played) << played.error().message;
    EXPECT_LT(played->info().duration_us, 200'000'000) << "recordings count in the steady clock";
  }
  EXPECT_EQ(scene_.reconnects("a", *client_), 0u) << scene_.logs();
}

std::string hash_of(const std::string& object) {
  return sha256(object).hex();
}

TEST_F(Fault, AnInterruptedUploadLeavesNothing) {
  auto broker = scene_.start_broker();
  const std::string object(300, 'x');
  const std::string id = hash_of(object);
  const std::string head = "PUT /v1/assets/" + id + " HTTP/1.1\r\nHost: localhost\r\nContent-Length: 300\r\n\r\n";
  const std::string upload = head + object;
  for (std::size_t cut = 1; cut < upload.size(); ++cut) {
    const int fd = connect_to(scene_.port());
    ASSERT_TRUE(send_all(fd, upload.substr(0, cut))) << cut;
    if (cut % 2 == 0) {  // With a reset.
      const linger now{1, 0};
      ::setsockopt(fd, SOL_SOCKET, SO_LINGER, &now, sizeof now);
    }
    ::close(fd);
  }
  // None is still to begin.
  const auto all_gone = [&] {
    const double seen =
        metric("eigencast_broker_connections_total") + metric("eigencast_broker_connections_refused_total");
    return seen == static_cast<double>(upload.size() - 1) && metric("eigencast_broker_connections") == 0;
  };
  EXPECT_TRUE(eventually(all_gone, kPatience)) << scene_.logs();
  EXPECT_GT(metric("eigencast_broker_uploads_failed_total"), 0);
  const auto nothing_left = [this] {
    return metric("eigencast_broker_uploads") == 0 && metric("eigencast_broker_asset_bytes") == 0 &&
           metric("eigencast_broker_asset_objects") == 0 &&
           std::filesystem::is_empty(scene_.file("assets") + "/assets/uploading");
  };
  EXPECT_TRUE(nothing_left()) << scene_.logs();

  // The broker itself goes in the middle of one.
  const int fd = connect_to(scene_.port());
  ASSERT_TRUE(send_all(fd, upload.substr(0, upload.size() - 1)));
  EXPECT_TRUE(eventually([&] { return metric("eigencast_broker_uploads") == 1; }, kPatience)) << scene_.logs();
  kill(*broker);
  ::close(fd);
  broker = scene_.start_broker();
  EXPECT_TRUE(nothing_left()) << scene_.logs();
  EXPECT_THAT(ask(scene_.port(), "GET", "/v1/assets/" + id), HasSubstr("404"));
  EXPECT_THAT(ask(scene_.port(), "PUT", "/v1/assets/" + id, object), HasSubstr("201"));
  EXPECT_EQ(body_of(ask(scene_.port(), "GET", "/v1/assets/" + id)), object);
}

TEST_F(Fault, AnInterruptedDownloadResumes) {
  auto broker = scene_.start_broker();
  std::string object;
  std::mt19937 random(1);
  for (int n = 0; n < 3'000'000; ++n) object += static_cast<char>(random());
  const std::string id = hash_of(object);
  ASSERT_THAT(ask(scene_.port(), "PUT", "/v1/assets/" + id, object), HasSubstr("201")) << scene_.logs();
  std::string got;
  while (got.size() < object.size()) {
    const int fd = connect_to(scene_.port());
    ASSERT_TRUE(send_all(fd, "GET /v1/assets/" + id +
                                 " HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nRange: bytes=" +
                                 std::to_string(got.size()) + "-\r\nIf-Range: \"" + id + "\"\r\n\r\n"));
    std::string answer(900'000, '\0');
    std::size_t size = 0;
    for (ssize_t count = 0; size < answer.size(); size += static_cast<std::size_t>(count)) {
      if ((count = ::recv(fd, answer.data() + size, answer.size() - size, 0)) <= 0) break;
    }
    ::close(fd);
    answer.resize(size);
    ASSERT_THAT(answer.substr(0, 12), "HTTP/1.1 206") << scene_.logs();
    got += body_of(answer);
    kill(*broker);  // A restart in between does not matter either.
    broker = scene_.start_broker();
  }
  EXPECT_EQ(hash_of(got), id);
}

TEST_F(Fault, DownloadsLetEveryFrameThrough) {
  start();
  const std::string object(16u << 20, 'x');
  const std::string id = hash_of(object);
  ASSERT_THAT(ask(scene_.port(), "PUT", "/v1/assets/" + id, object), HasSubstr("201")) << scene_.logs();
  const std::string request = "GET /v1/assets/" + id + " HTTP/1.1\r\nHost: localhost\r\n\r\n";
  std::vector<int> unread;
  for (int i = 0; i < 40; ++i) {
    unread.push_back(connect_to(scene_.port()));
    ASSERT_TRUE(send_all(unread.back(), request));
  }
  const auto poses = scene_.received("a").size();
  std::size_t rounds = 0;
  for (; rounds < 200 && scene_.received("a").size() < poses + 90; ++rounds) {
    ASSERT_EQ(body_of(ask(scene_.port(), "GET", "/v1/assets/" + id)).size(), object.size()) << scene_.logs();
  }
  EXPECT_GE(scene_.received("a").size(), poses + 90) << scene_.logs();
  EXPECT_GT(rounds, 0u);
  EXPECT_LT(metric("eigencast_broker_frames_dropped_total"), 45) << "a slow machine's viewer may miss some";
  for (const int fd : unread) ::close(fd);
}

}  // namespace
}  // namespace eigencast::testing
