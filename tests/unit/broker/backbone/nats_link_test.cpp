// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/read.hpp>
#include <boost/asio/read_until.hpp>
#include <boost/asio/write.hpp>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <mutex>
#include <optional>
#include <sstream>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "broker/backbone/nats_link.h"
#include "broker/config/config.h"

namespace eigencast::broker {
namespace {

using boost::asio::ip::tcp;
using std::chrono_literals::operator""s;

constexpr auto kPatience = 60s;

/// What a NATS server does to one connection.
enum class Manner {
  kTakes,
  kCloses,
  kSaysNothing,
  kClosesAfterInfo,
  kMuteAfterInfo,
  kMuteInTls,
  kRefusesUser,
  kFails,
  kSpeaksNoTls,
  kTalksNonsense
};

/// A NATS server on loopback that treats its first connections as the test says, and takes all later ones.
class NatsPeer {
 public:
  explicit NatsPeer(std::vector<Manner> manners) : manners_(manners.begin(), manners.end()) {
    thread_ = std::thread([this] {
      for (;;) {
        tcp::socket socket(io_);
        boost::system::error_code error;
        acceptor_.accept(socket, error);
        if (error || ending_) return;
        ++connections_;
        const Manner manner = manners_.empty() ? Manner::kTakes : manners_.front();
        if (!manners_.empty()) manners_.pop_front();
        converse(socket, manner);
      }
    });
  }
  ~NatsPeer() {
    ending_ = true;
    boost::system::error_code error;
    tcp::socket(io_).connect(acceptor_.local_endpoint(), error);
    thread_.join();
  }
  NatsPeer(const NatsPeer&) = delete;
  NatsPeer& operator=(const NatsPeer&) = delete;

  std::string address() const { return "nats://127.0.0.1:" + std::to_string(acceptor_.local_endpoint().port()); }
  int connections() const { return connections_; }
  bool mute() const { return mute_; }  ///< A client waits for a word.
  /// How often, on all connections, a line of clients began so.
  int count(const std::string& begin) const {
    const std::lock_guard lock(mutex_);
    return static_cast<int>(
        std::count_if(heard_.begin(), heard_.end(), [&](const auto& line) { return line.starts_with(begin); }));
  }
  /// The number of the client's subscription; waits for it.
  std::string number_of(const std::string& subject) const {
    const std::string line = line_of("SUB " + subject);
    return line.substr(line.rfind(' ') + 1);
  }
  /// The last line that began so; waits for it.
  std::string line_of(const std::string& begin) const {
    for (;; std::this_thread::sleep_for(std::chrono::milliseconds(5))) {
      const std::lock_guard lock(mutex_);
      const auto found =
          std::find_if(heard_.rbegin(), heard_.rend(), [&](const auto& line) { return line.starts_with(begin); });
      if (found != heard_.rend()) return *found;
    }
  }
  /// Is sent once to the client that is connected.
  void say(const std::string& line) {
    const std::lock_guard lock(mutex_);
    said_ += line;
  }

 private:
  /// Ends when the client has gone, or this server sends it away.
  void converse(tcp::socket& socket, Manner manner) {
    boost::system::error_code error;
    const auto send = [&](const std::string& text) { boost::asio::write(socket, boost::asio::buffer(text), error); };
    std::string buffer;
    const auto line = [&] {
      const std::size_t size = boost::asio::read_until(socket, boost::asio::dynamic_buffer(buffer), "\r\n", error);
      const std::string read = error ? "" : buffer.substr(0, size - 2);
      buffer.erase(0, size);
      return read;
    };
    if (manner == Manner::kCloses) return;
    const auto say_nothing = [&] {
      mute_ = true;
      while (!error) boost::asio::read(socket, boost::asio::dynamic_buffer(buffer), error);
    };
    if (manner == Manner::kSaysNothing) return say_nothing();
    if (manner == Manner::kTalksNonsense) return send("HTTP/1.1 400 Bad Request\r\n\r\n");
    const bool tls_wanted = manner == Manner::kSpeaksNoTls || manner == Manner::kMuteInTls;
    const std::string tls = tls_wanted ? R"(,"tls_required":true)" : "";
    send(R"(INFO {"server_id":"peer","version":"2.9.10","headers":true,"max_payload":1048576)" + tls + "}\r\n");
    if (manner == Manner::kClosesAfterInfo) return;
    if (manner == Manner::kSpeaksNoTls) {
      boost::asio::read(socket, boost::asio::dynamic_buffer(buffer), boost::asio::transfer_at_least(1), error);
      return send("no TLS here\r\n");
    }
    if (manner == Manner::kMuteInTls) {
      boost::asio::read(socket, boost::asio::dynamic_buffer(buffer), boost::asio::transfer_at_least(1), error);
      return say_nothing();
    }
    line();  // CONNECT
    if (manner == Manner::kMuteAfterInfo) return say_nothing();
    if (manner == Manner::kRefusesUser) return send("-ERR 'Authorization Violation'\r\n");
    if (manner == Manner::kFails) return send("-ERR 'Authentication Timeout'\r\n");
    while (!error && !ending_) {
      {
        const std::lock_guard lock(mutex_);
        if (!said_.empty()) send(std::exchange(said_, {}));
      }
      const std::string read = line();  // The client pings several times a second.
      std::string subject, number;
      if (read == "PING") send("PONG\r\n");
      {
        const std::lock_guard lock(mutex_);
        heard_.push_back(read);
      }
      std::istringstream words(read);
      std::string word;
      if (words >> word >> subject >> number && word == "SUB" && subject == "news") {
        send("MSG news " + number + " 2\r\nhi\r\n");
      }
    }
  }

  boost::asio::io_context io_;
  tcp::acceptor acceptor_{io_, tcp::endpoint(boost::asio::ip::address_v4::loopback(), 0)};
  std::deque<Manner> manners_;
  std::atomic<int> connections_{0};
  std::atomic<bool> ending_{false};
  std::atomic<bool> mute_{false};
  mutable std::mutex mutex_;
  std::string said_;
  std::vector<std::string> heard_;
  std::thread thread_;
};

/// The event loop of a link, run by the test.
class PumpedLoop : public Link::Listener {
 public:
  void post(std::function<void()> work) {
    const std::lock_guard lock(mutex_);
    work_.push_back(std::move(work));
    wake_.notify_all();
  }
  template <typename Condition>
  bool run_until(Condition&& condition) {
    const auto until = std::chrono::steady_clock::now() + kPatience;
    std::unique_lock lock(mutex_);
    while (!condition()) {
      if (std::chrono::steady_clock::now() > until) return false;
      if (!wake_.wait_for(lock, std::chrono::milliseconds(10), [this] { return !work_.empty(); })) continue;
      const auto work = std::move(work_.front());
      work_.pop_front();
      lock.unlock();
      work();
      lock.lock();
    }
    return true;
  }

  /// The last that was posted first: nothing orders what several threads post.
  void run_backwards() {
    std::unique_lock lock(mutex_);
    const auto posted = std::exchange(work_, {});
    lock.unlock();
    for (auto work = posted.rbegin(); work != posted.rend(); ++work) (*work)();
  }
  std::size_t waiting() const {
    const std::lock_guard lock(mutex_);
    return work_.size();
  }

  void on_connected() override {
    ++connected;
    order += '+';
  }
  void on_disconnected(const std::string&) override {
    ++disconnected;
    order += '-';
  }
  void on_new_table() override {}
  void on_row(const std::string&, std::optional<std::string>, std::uint64_t, const std::string&) override {}
  void on_table_read() override {}

  int connected = 0, disconnected = 0;
  std::string order;

 private:
  mutable std::mutex mutex_;
  std::condition_variable wake_;
  std::deque<std::function<void()>> work_;
};

class NatsLinkTest : public ::testing::TestWithParam<Manner> {
 protected:
  void start(std::vector<Manner> manners) {
    peer_.emplace(std::move(manners));
    Config config;
    config.backbone.servers = {peer_->address()};
    auto link = make_nats_link(config, "test", [this](std::function<void()> work) { loop_.post(std::move(work)); });
    ASSERT_TRUE(link) << link.error().message;
    link_ = std::move(*link);
    link_->start(loop_);
    news_ = link_->subscribe(
        "news", [this](const std::string&, const Bytes& message) { heard_ += message.size() == 2 ? 1 : 0; });
  }
  void TearDown() override {
    news_.reset();
    if (link_) link_->stop();
  }

  /// Has `exchange` talk to the peer until what it returns becomes true, again if the connection is lost meanwhile: a
  /// busy machine may miss its pings. It is given a number of the connection.
  template <typename Exchange>
  void on_lasting_connection(Exchange&& exchange) {
    int lost = 0;
    do {
      ASSERT_TRUE(
          loop_.run_until([&] { return loop_.connected == loop_.disconnected + 1 && heard_ == loop_.connected; }));
      lost = loop_.disconnected;
      const auto done = exchange(std::to_string(lost));
      ASSERT_TRUE(loop_.run_until([&] { return loop_.disconnected != lost || done(); }));
    } while (loop_.disconnected != lost);
  }

  PumpedLoop loop_;
  std::optional<NatsPeer> peer_;
  std::shared_ptr<Link> link_;
  std::shared_ptr<void> news_;
  int heard_ = 0;
};

TEST_P(NatsLinkTest, ConnectsAfterThreeFailures) {
  start(std::vector<Manner>(3, GetParam()));
  EXPECT_TRUE(loop_.run_until([&] { return loop_.connected == 1 && heard_ == 1; })) << peer_->connections() << " tries";
  EXPECT_GE(loop_.disconnected, 1) << "the first failure is reported";
  EXPECT_EQ(peer_->connections(), 4);
}

TEST_P(NatsLinkTest, ConnectsAgainAfterThreeFailures) {
  start({Manner::kTakes, GetParam(), GetParam(), GetParam()});
  ASSERT_TRUE(loop_.run_until([&] { return loop_.connected == 1 && heard_ == 1; }));
  peer_->say("-ERR 'Stale Connection'\r\n");
  EXPECT_TRUE(loop_.run_until([&] { return loop_.connected == 2 && heard_ == 2; })) << peer_->connections() << " tries";
  EXPECT_EQ(peer_->connections(), 5);
}

INSTANTIATE_TEST_SUITE_P(Failures, NatsLinkTest,
                         ::testing::Values(Manner::kCloses, Manner::kSaysNothing, Manner::kClosesAfterInfo,
                                           Manner::kMuteAfterInfo, Manner::kMuteInTls, Manner::kRefusesUser,
                                           Manner::kFails, Manner::kSpeaksNoTls, Manner::kTalksNonsense));

class MuteNatsServerTest : public NatsLinkTest {};

/// What fails waits as long as libnats does: to the end of days, within a handshake.
TEST_P(MuteNatsServerTest, HoldsUpNeitherStartNorStop) {
  start({GetParam()});
  while (!peer_->mute()) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  link_->publish("news", {1});
  link_->stop();
}

TEST_P(MuteNatsServerTest, HoldsUpNoStopThatFindsItReconnecting) {
  start({Manner::kTakes, GetParam()});
  ASSERT_TRUE(loop_.run_until([&] { return loop_.connected == 1 && heard_ == 1; }));
  peer_->say("-ERR 'Stale Connection'\r\n");
  while (!peer_->mute()) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  link_->stop();
}

INSTANTIATE_TEST_SUITE_P(Mute, MuteNatsServerTest,
                         ::testing::Values(Manner::kSaysNothing, Manner::kMuteAfterInfo, Manner::kMuteInTls));

TEST_F(NatsLinkTest, LossAndNewConnectionAreHeardInTheirOrder) {
  start({});
  ASSERT_TRUE(loop_.run_until([&] { return loop_.connected == 1 && heard_ == 1; }));
  peer_->say("-ERR 'Stale Connection'\r\n");
  while (peer_->count("SUB news ") < 2) std::this_thread::sleep_for(std::chrono::milliseconds(5));
  loop_.run_backwards();
  EXPECT_TRUE(loop_.run_until([&] { return loop_.connected == 2; }));
  EXPECT_EQ(loop_.order, "+-+");
}

TEST(ConnectionNewsTest, ALossComesBeforeTheNextConnection) {
  PumpedLoop listener;
  ConnectionNews news;
  const auto report = [&] { std::exchange(news, {}).report(listener); };
  report();
  EXPECT_EQ(listener.order, "") << "nothing has changed";
  news.note_lost("why");
  news.note_connected();
  report();
  report();
  EXPECT_EQ(listener.order, "-+") << "once";
  news.note_lost("why");
  news.note_connected();
  news.note_lost("why");
  report();
  EXPECT_EQ(listener.order, "-+-") << "a connection that is gone is not reported";
}

/// Whose messages wait is nothing to others: the peer takes them more slowly than they come.
TEST_F(NatsLinkTest, AFloodOfOneHolderDropsNoMessageOfOthers) {
  start({});
  constexpr int kRounds = 20, kFlood = 20'000;
  on_lasting_connection([&](const std::string& connection) {
    for (int round = 0; round < kRounds; ++round) {
      for (int i = 0; i < kFlood; ++i) link_->publish("flood", {}, "hog");
      link_->publish("frames" + connection, {}, "other");
      link_->publish("alive" + connection, {});
    }
    return [&, connection] {
      return peer_->count("PUB frames" + connection + " ") == kRounds &&
             peer_->count("PUB alive" + connection + " ") == kRounds;
    };
  });
}

TEST_F(NatsLinkTest, RequestsAreAnsweredInInboxesOnly) {
  start({});
  const auto served = link_->serve("asked", [](const Bytes&, const Link::Reply& reply) { reply({'y'}); });
  ASSERT_TRUE(loop_.run_until([&] { return loop_.connected == 1 && heard_ == 1; }));
  const std::string number = peer_->number_of("asked ");
  for (const char* reply : {"eigencast.rows.test", "$JS.API.STREAM.DELETE.KV_eigencast_streams", "_INBOX.other.1"}) {
    peer_->say("MSG asked " + number + " " + reply + " 2\r\nhi\r\n");
  }
  EXPECT_TRUE(loop_.run_until([&] { return peer_->count("PUB _INBOX.other.1 ") == 1; }));
  EXPECT_EQ(peer_->count("PUB eigencast."), 0) << "what others choose, in its own name";
  EXPECT_EQ(peer_->count("PUB $JS.API.STREAM.DELETE."), 0);
}

TEST_F(NatsLinkTest, WhereAnAnswerIsAwaitedCannotBeGuessed) {
  start({});
  std::string answered;
  const auto ask = [&](const std::string& subject) {
    link_->ask(subject, {}, 600'000'000, [&](const Result<Bytes>& answer) {
      if (answer) answered.assign(answer->begin(), answer->end());
    });
    std::string reply = peer_->line_of("PUB " + subject + " ").substr(5 + subject.size());
    return reply.substr(0, reply.find(' '));
  };
  on_lasting_connection([&](const std::string& connection) {
    answered.clear();
    const std::string first = ask("first" + connection), second = ask("second" + connection);
    const std::size_t dot = first.rfind('.');
    const std::string number = peer_->number_of(first.substr(0, dot + 1));
    const auto say = [&](const std::string& subject, const std::string& text) {
      peer_->say("MSG " + subject + " " + number + " " + std::to_string(text.size()) + "\r\n" + text + "\r\n");
    };
    say(first.substr(0, dot + 1) + std::to_string(std::strtoull(first.c_str() + dot + 1, nullptr, 10) + 1), "forged");
    say(second, "true");
    return [&] { return !answered.empty(); };
  });
  EXPECT_EQ(answered, "true");
}

/// JetStream delivers rows that a broker wrote to any subject that its consumer names, past its permissions.
TEST_F(NatsLinkTest, OnlyMessagesOfTheirOwnSubjectAreHeard) {
  start({});
  std::vector<std::string> subjects;
  const auto hear = [&](const std::string& subject, const Bytes&) { subjects.push_back(subject); };
  const auto exact = link_->subscribe("frames.edge-2.1.s", hear), below = link_->subscribe("alive.>", hear);
  on_lasting_connection([&](const std::string&) {
    subjects.clear();
    const std::string one = peer_->number_of("frames.edge-2.1.s "), all = peer_->number_of("alive.> ");
    std::string said;
    for (const char* subject : {"$KV.eigencast_streams.x", "frames.edge-2.1.s.t", "x", "frames.edge-2.1.s"}) {
      said += std::string("MSG ") + subject + " " + one + " 2\r\nhi\r\n";
    }
    for (const char* subject : {"$KV.eigencast_streams.alive.x", "alive", "x", "alive.edge-2.1"}) {
      said += std::string("MSG ") + subject + " " + all + " 2\r\nhi\r\n";
    }
    peer_->say(said);
    return [&] { return !subjects.empty() && subjects.back() == "alive.edge-2.1"; };
  });
  EXPECT_EQ(subjects, (std::vector<std::string>{"frames.edge-2.1.s", "alive.edge-2.1"}));
}

/// A stream may be made to publish again what it stores, and consumers replay it, in its own subject.
TEST_F(NatsLinkTest, WhatHasAHeaderOrAReplyIsNoMessageOfABroker) {
  start({});
  std::string all;
  const auto alive = link_->subscribe(
      "alive.>", [&](const std::string&, const Bytes& message) { all.append(message.begin(), message.end()); });
  on_lasting_connection([&](const std::string&) {
    all.clear();
    const std::string number = peer_->number_of("alive.> ");
    const std::string again = "NATS/1.0\r\nNats-Sequence: 7\r\n\r\n", status = "NATS/1.0 100 Idle Heartbeat\r\n\r\n",
                      nobody = "NATS/1.0 503\r\n\r\n";
    const auto with = [&](const std::string& head, const std::string& text) {
      return "HMSG alive.edge-2.1 " + number + " " + std::to_string(head.size()) + " " +
             std::to_string(head.size() + text.size()) + "\r\n" + head + text + "\r\n";
    };
    peer_->say(with(again, "a") + with(status, "") + with(nobody, "") + "MSG alive.edge-2.1 " + number +
               " $JS.ACK.KV_eigencast_streams.x.1.1.1.1.0 1\r\nb\r\n" + "MSG alive.edge-2.1 " + number + " 1\r\n+\r\n");
    return [&] { return all.ends_with('+'); };
  });
  EXPECT_EQ(all, "+");
}

TEST_F(NatsLinkTest, AFloodOfOneSubjectLeavesRoomForOthers) {
  start({});
  int others = 0;
  const auto other = link_->subscribe("other", [&](const std::string&, const Bytes&) { ++others; });
  on_lasting_connection([&](const std::string&) {
    const std::string flooded = peer_->number_of("news "), quiet = peer_->number_of("other ");
    std::string flood;
    for (int i = 0; i < 28'000; ++i) {
      flood += "MSG news " + flooded + " 1000\r\n" + std::string(1000, 'x') + "\r\n";
    }
    others = 0;
    peer_->say(flood + "MSG other " + quiet + " 2\r\nhi\r\n");
    std::size_t before = 0;
    do {  // Until all that comes has come, or the loop is as far behind as it can be.
      before = loop_.waiting();
      std::this_thread::sleep_for(std::chrono::milliseconds(500));
    } while (loop_.waiting() != before || before < 100);
    return [&] { return others == 1; };
  });
}

TEST_F(NatsLinkTest, ErrorsOfAConnectionMakeANewOne) {
  start({});
  ASSERT_TRUE(loop_.run_until([&] { return loop_.connected == 1 && heard_ == 1; }));
  int times = 1;
  for (const char* error : {"Slow Consumer", "Authorization Violation", "Maximum Connections Exceeded"}) {
    peer_->say(std::string("-ERR '") + error + "'\r\n");
    if (std::string(error) == "Authorization Violation") peer_->say("-ERR 'Authorization Violation'\r\n");
    ++times;
    EXPECT_TRUE(loop_.run_until([&] { return loop_.connected == times && heard_ == times; })) << error;
  }
  EXPECT_EQ(loop_.disconnected, 3);
}

}  // namespace
}  // namespace eigencast::broker
