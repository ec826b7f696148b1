// SPDX-License-Identifier: MIT
#include "common/net/websocket.h"

#include <dlfcn.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netdb.h>
#include <sys/socket.h>

#include <array>
#include <atomic>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/websocket.hpp>
#include <functional>
#include <mutex>
#include <stdexcept>
#include <thread>
#include <vector>

#include "common/wire/control.h"
#include "tests/support/loopback_broker.h"

/// A name of several addresses, which no machine of a test has otherwise.
extern "C" int getaddrinfo(const char* host, const char* service, const addrinfo* hints, addrinfo** found) {
  static const auto real = reinterpret_cast<decltype(&::getaddrinfo)>(::dlsym(RTLD_NEXT, "getaddrinfo"));
  if (host == nullptr || std::string_view(host) != "several.test") return real(host, service, hints, found);
  addrinfo** end = found;
  for (const char* address : {"127.0.0.3" /* nobody listens */, "127.0.0.1", "127.0.0.2"}) {
    if (const int error = real(address, service, hints, end)) return error;
    while (*end != nullptr) end = &(*end)->ai_next;
  }
  return 0;
}

namespace eigencast {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
using asio::ip::tcp;
using testing::eventually;
using ::testing::HasSubstr;
using testing::LoopbackBroker;
using testing::milliseconds;

/// What happened on a connection, for a test's thread to check.
struct Log {
  std::mutex mutex;
  std::vector<std::string> texts;
  std::vector<std::pair<Error, milliseconds>> downs;
  std::vector<BrokerUrl> reached;
  std::atomic<int> opened{0};

  WebSocketEvents events() {
    WebSocketEvents e;
    e.on_open = [this](const BrokerUrl& broker) {
      const std::lock_guard lock(mutex);
      reached.push_back(broker);
      ++opened;
    };
    e.on_text = [this](std::string_view text) {
      const std::lock_guard lock(mutex);
      texts.emplace_back(text);
    };
    e.on_binary = [](ByteView) {};
    e.on_down = [this](const Error& why, milliseconds wait) {
      const std::lock_guard lock(mutex);
      downs.emplace_back(why, wait);
    };
    return e;
  }
  std::size_t down_count() {
    const std::lock_guard lock(mutex);
    return downs.size();
  }
  std::pair<Error, milliseconds> down(std::size_t i) {
    const std::lock_guard lock(mutex);
    return downs.at(i);
  }
  BrokerUrl broker(std::size_t i) {
    const std::lock_guard lock(mutex);
    return reached.at(i);
  }
  std::string first_text() {
    const std::lock_guard lock(mutex);
    return texts.empty() ? "" : texts.front();
  }
};

WebSocketOptions options_for(const std::string& url, const std::string& target) {
  WebSocketOptions options;
  options.url = *parse_broker_url(url);
  options.target = target;
  options.first_retry = milliseconds(20);
  options.longest_retry = milliseconds(60000);
  return options;
}

TEST(WebSocketToBroker, OpensAndReceivesTheWelcome) {
  LoopbackBroker broker;
  Log log;
  const auto socket = WebSocket::start(options_for(broker.url(""), "/v1/subscribe/a"), log.events());
  ASSERT_TRUE(eventually([&] { return !log.first_text().empty(); }));
  EXPECT_TRUE(std::holds_alternative<control::Welcome>(*control_from_text(log.first_text())));
  EXPECT_TRUE(socket->is_open());
  socket->stop();
  EXPECT_FALSE(socket->is_open());
  EXPECT_EQ(socket->send_text("x"), SendStatus::kDisconnected);
  EXPECT_EQ(log.down_count(), 0u) << "no event comes after stop";
}

TEST(WebSocketToBroker, ReconnectsAfterARestart) {
  LoopbackBroker broker;
  Log log;
  auto options = options_for(broker.url(""), "/v1/subscribe/a");
  options.longest_retry = milliseconds(40);
  const auto socket = WebSocket::start(std::move(options), log.events());
  ASSERT_TRUE(eventually([&] { return log.opened == 1; }));
  broker.stop();
  ASSERT_TRUE(eventually([&] { return log.down_count() >= 2; }));
  EXPECT_EQ(socket->send_binary(Bytes(10)), SendStatus::kDisconnected);
  EXPECT_EQ(log.down(1).first.code, ErrorCode::kUnreachable);
  EXPECT_GT(log.down(1).second.count(), 0);
  broker.start();
  EXPECT_TRUE(eventually([&] { return log.opened == 2; }));
}

std::string url_of(const LoopbackBroker& a, const LoopbackBroker& b) {
  return "ws://127.0.0.1:" + std::to_string(a.port()) + ",127.0.0.1:" + std::to_string(b.port()) + "/a";
}

TEST(WebSocketToBroker, GoesOnAtTheNextBroker) {
  LoopbackBroker a, b;
  Log log;
  auto options = options_for(url_of(a, b), "/v1/subscribe/a");
  options.longest_retry = milliseconds(40);
  const auto socket = WebSocket::start(std::move(options), log.events());
  const std::uint16_t order[] = {a.port(), b.port(), a.port()};
  for (std::size_t i = 0; i < 3; ++i) {
    ASSERT_TRUE(eventually([&] { return log.opened == static_cast<int>(i + 1); }));
    ASSERT_EQ(log.broker(i).port, order[i]);
    EXPECT_EQ(log.broker(i).brokers(), 1u);
    (i % 2 == 0 ? b : a).start();
    (i % 2 == 0 ? a : b).stop();
  }
}

TEST(WebSocketToBroker, BrokerOfAListIsNotWaitedFor) {
  LoopbackBroker a, b;
  Log log;
  auto options = options_for(url_of(a, b), "/v1/subscribe/a");
  options.first_retry = milliseconds(3'600'000);
  const auto socket = WebSocket::start(std::move(options), log.events());
  ASSERT_TRUE(eventually([&] { return log.opened == 1; }));
  a.stop();
  ASSERT_TRUE(eventually([&] { return log.opened == 2; }));
  EXPECT_EQ(log.broker(1).port, b.port());
  b.stop();
  ASSERT_TRUE(eventually([&] { return log.down_count() == 2; }));
  EXPECT_LE(log.down(0).second, milliseconds(51));
  const std::string next = ":" + std::to_string(b.port());
  EXPECT_NE(log.down(0).first.message.find(next), std::string::npos) << log.down(0).first.message;
  EXPECT_GT(log.down(1).second, milliseconds(2'000'000)) << "both have failed: their back-off";
}

TEST(WebSocketToBroker, RefusalWaitsTheLongestInterval) {
  LoopbackBroker broker;
  Log log;
  const auto socket = WebSocket::start(options_for(broker.url(""), "/v1/subscribe/bad..%20name"), log.events());
  ASSERT_TRUE(eventually([&] { return log.down_count() >= 1; }));
  EXPECT_EQ(log.down(0).first.code, ErrorCode::kRefused);
  EXPECT_GE(log.down(0).second.count(), 45000);
}

TEST(WebSocketToBroker, HoldOffDelaysTheReconnect) {
  for (const milliseconds pause : {milliseconds(100'000), milliseconds(0)}) {
    LoopbackBroker broker;
    Log log;
    const auto socket = WebSocket::start(options_for(broker.url(""), "/v1/subscribe/a"), log.events());
    ASSERT_TRUE(eventually([&] { return log.opened == 1; }));
    socket->hold_off(pause);
    broker.stop();
    ASSERT_TRUE(eventually([&] { return log.down_count() >= 1; }));
    // With 0 it does not expect us back soon: the longest interval, which is 60 s here, less its jitter.
    EXPECT_GE(log.down(0).second.count(), pause.count() > 0 ? 100'000 : 45'000);
  }
}

TEST(WebSocketToBroker, HoldOffHasABound) {
  constexpr milliseconds kWeeks{4'294'967'295};
  for (const bool several : {false, true}) {
    LoopbackBroker broker, other;
    Log log;
    const std::string url = several ? url_of(broker, other) : broker.url("");
    const auto socket = WebSocket::start(options_for(url, "/v1/subscribe/a"), log.events());
    ASSERT_TRUE(eventually([&] { return log.opened == 1; }));
    socket->hold_off(kWeeks);
    broker.stop();
    ASSERT_TRUE(eventually([&] { return log.down_count() >= 1; }));
    EXPECT_LE(log.down(0).second.count(), several ? 30'001 : 750'000);
  }
}

TEST(WebSocketToBroker, ThrowingHandlerEndsOnlyTheConnection) {
  LoopbackBroker broker;
  Log log;
  auto events = log.events();
  events.on_text = [&log](std::string_view) {
    if (log.opened == 1) throw std::runtime_error("out of luck");
  };
  const auto socket = WebSocket::start(options_for(broker.url(""), "/v1/subscribe/a"), std::move(events));
  ASSERT_TRUE(eventually([&] { return log.opened == 2; }));
  EXPECT_EQ(log.down(0).first.code, ErrorCode::kInternal);
  EXPECT_THAT(log.down(0).first.message, HasSubstr("out of luck"));
  EXPECT_TRUE(socket->is_open());
}

TEST(WebSocket, ServerWithoutTlsIsUnreachable) {
  LoopbackBroker broker;
  std::string url = broker.url("a");
  url.replace(0, 2, "wss");
  Log log;
  const auto socket = WebSocket::start(options_for(url, "/v1/subscribe/a"), log.events());
  ASSERT_TRUE(eventually([&] { return log.down_count() >= 1; }));
  EXPECT_EQ(log.down(0).first.code, ErrorCode::kUnreachable);
  EXPECT_GT(log.down(0).second.count(), 0);
}

/// Accepts one connection, upgrades it if `protocol` says how, does what it is asked, and then never reads again.
class DeafServer {
 public:
  using Socket = beast::websocket::stream<tcp::socket, false>;
  explicit DeafServer(std::string protocol, std::function<void(Socket&)> first = {})
      : acceptor_(loop_, tcp::endpoint(asio::ip::address_v4::loopback(), 0)), socket_(loop_) {
    // A small window, so that a test fills it soon; set before accepting, as TCP wants it.
    acceptor_.set_option(asio::socket_base::receive_buffer_size(4096));
    thread_ = std::thread([this, p = std::move(protocol), before_that = std::move(first)] {
      acceptor_.accept(socket_.next_layer());
      if (p == "none") return;
      socket_.set_option(beast::websocket::stream_base::decorator(
          [&](beast::websocket::response_type& r) { r.set(beast::http::field::sec_websocket_protocol, p); }));
      boost::system::error_code ignored;
      socket_.accept(ignored);
      if (before_that) before_that(socket_);
    });
  }
  ~DeafServer() { thread_.join(); }
  std::string url() const { return "ws://127.0.0.1:" + std::to_string(acceptor_.local_endpoint().port()); }

 private:
  asio::io_context loop_;
  tcp::acceptor acceptor_;
  Socket socket_;
  std::thread thread_;
};

TEST(WebSocket, UnsentBytesAreCountedThenDropped) {
  DeafServer server("eigencast.v2");
  Log log;
  auto options = options_for(server.url(), "/");
  options.max_unsent_bytes = 100'000;
  const auto socket = WebSocket::start(std::move(options), log.events());
  ASSERT_TRUE(eventually([&] { return socket->is_open(); }));
  int sent = 0, dropped = 0;
  // More than all buffers between the two can hold.
  for (int i = 0; i < 2000; ++i) {
    (socket->send_binary(Bytes(10'000)) == SendStatus::kSent ? sent : dropped) += 1;
    ASSERT_LE(socket->unsent_bytes(), 100'000u);
  }
  EXPECT_GT(sent, 0);
  EXPECT_GT(dropped, 0);
  EXPECT_TRUE(eventually([&] { return socket->send_binary(Bytes(10'000)) == SendStatus::kDropped; }));
  socket->stop();  // Must end although the peer never answers the close.
}

TEST(WebSocket, ConcurrentSendsArriveWholeAndInOrder) {
  constexpr std::uint8_t kThreads = 3, kEach = 250;
  // Some longer than what Beast writes at a time.
  const auto message_of = [](std::uint8_t thread, std::uint8_t number) {
    Bytes message(2 + number * 37 % 9000, static_cast<std::uint8_t>(thread ^ number));
    message[0] = thread, message[1] = number;
    return message;
  };
  std::array<std::uint8_t, kThreads> heard{};
  std::atomic<bool> all_heard = false;
  DeafServer server("eigencast.v2", [&](DeafServer::Socket& socket) {
    beast::flat_buffer in;
    for (int i = 0; i < kThreads * kEach; ++i, in.clear()) {
      if (i % 4 == 0) socket.ping({});  // Answers leave among the messages.
      socket.read(in);
      const auto* first = static_cast<const std::uint8_t*>(in.cdata().data());
      ASSERT_LT(first[0], kThreads);
      ASSERT_EQ(Bytes(first, first + in.size()), message_of(first[0], heard[first[0]]++));
    }
    all_heard = true;
  });
  Log log;
  auto options = options_for(server.url(), "/");
  options.max_unsent_bytes = 1 << 30;
  const auto socket = WebSocket::start(std::move(options), log.events());
  ASSERT_TRUE(eventually([&] { return socket->is_open(); }));
  std::vector<std::thread> senders;
  for (std::uint8_t thread = 0; thread < kThreads; ++thread) {
    senders.emplace_back([&, thread] {
      for (std::uint8_t number = 0; number < kEach; ++number) {
        EXPECT_EQ(socket->send_binary(message_of(thread, number)), SendStatus::kSent);
        if (number % 8 == 0) std::this_thread::yield();
      }
    });
  }
  for (std::thread& sender : senders) sender.join();
  EXPECT_TRUE(eventually([&] { return all_heard.load(); }));
}

TEST(WebSocket, SilentPeerTimesOut) {
  DeafServer server("eigencast.v2");
  Log log;
  auto options = options_for(server.url(), "/");
  options.silence_timeout = milliseconds(100);
  const auto socket = WebSocket::start(std::move(options), log.events());
  ASSERT_TRUE(eventually([&] { return log.down_count() >= 1; }));
  EXPECT_EQ(log.opened, 1);
  EXPECT_EQ(log.down(0).first.code, ErrorCode::kTimeout);
}

TEST(WebSocket, PeerThatNeverUpgradesTimesOut) {
  DeafServer server("none");
  Log log;
  auto options = options_for(server.url(), "/");
  options.connect_timeout = milliseconds(100);
  const auto socket = WebSocket::start(std::move(options), log.events());
  ASSERT_TRUE(eventually([&] { return log.down_count() >= 1; }));
  EXPECT_EQ(log.opened, 0);
  EXPECT_EQ(log.down(0).first.code, ErrorCode::kTimeout);
}

TEST(WebSocket, PeerOfAnotherProtocolIsRefused) {
  DeafServer server("chat");
  Log log;
  const auto socket = WebSocket::start(options_for(server.url(), "/"), log.events());
  ASSERT_TRUE(eventually([&] { return log.down_count() >= 1; }));
  EXPECT_EQ(log.down(0).first.code, ErrorCode::kIncompatibleVersion);
  EXPECT_EQ(log.opened, 0);
}

/// Has its connections upgraded, and ends each when it is told.
class ServerAt {
 public:
  using Socket = beast::websocket::stream<tcp::socket, false>;
  ServerAt(const char* address, std::uint16_t port)
      : acceptor_(loop_, tcp::endpoint(asio::ip::make_address(address), port)) {
    thread_ = std::thread([this] {
      for (boost::system::error_code ec; !ec;) {
        Socket socket(loop_);
        acceptor_.accept(socket.next_layer(), ec);
        if (ec) return;
        socket.set_option(beast::websocket::stream_base::decorator([](beast::websocket::response_type& r) {
          r.set(beast::http::field::sec_websocket_protocol, "eigencast.v2");
        }));
        boost::system::error_code ended;
        socket.accept(ended);
        beast::flat_buffer in;
        if (!ended) socket.read(in, ended);
      }
    });
  }
  ~ServerAt() {
    ::shutdown(acceptor_.native_handle(), SHUT_RDWR);
    thread_.join();
  }
  std::uint16_t port() const { return acceptor_.local_endpoint().port(); }

 private:
  asio::io_context loop_;
  tcp::acceptor acceptor_;
  std::thread thread_;
};

TEST(WebSocket, AddressesOfANameAreTriedInTurn) {
  ServerAt one("127.0.0.1", 0);
  ServerAt two("127.0.0.2", one.port());
  Log log;
  const auto url = "ws://several.test:" + std::to_string(one.port()) + "/a";
  auto options = options_for(url, "/");
  options.longest_retry = milliseconds(40);
  const auto socket = WebSocket::start(std::move(options), log.events());
  for (std::size_t i = 0; i < 4; ++i) {
    ASSERT_TRUE(eventually([&] { return log.opened == static_cast<int>(i + 1); }));
    EXPECT_EQ(log.broker(i).address, i % 2 == 0 ? "127.0.0.1" : "127.0.0.2");
    EXPECT_EQ(log.broker(i).host, "several.test");
    EXPECT_EQ(log.down_count(), i) << "the address without a server is passed over";
    EXPECT_EQ(socket->send_text("bye"), SendStatus::kSent);
  }
}

TEST(WebSocket, StopsWhileItConnects) {
  Log log;
  // A reserved address: nobody answers there.
  const auto socket = WebSocket::start(options_for("ws://192.0.2.1:9/a", "/"), log.events());
  socket->stop();
  EXPECT_EQ(log.opened, 0);
}

}  // namespace
}  // namespace eigencast
