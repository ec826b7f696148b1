// SPDX-License-Identifier: MIT
// Publisher and subscriber against a broker that says what a real one seldom does.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/websocket.hpp>
#include <cmath>
#include <mutex>
#include <thread>
#include <vector>

#include "common/surface/shapes.h"
#include "sdk/bake.h"
#include "sdk/publisher.h"
#include "sdk/subscriber.h"
#include "tests/support/process.h"

namespace eigencast {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
using asio::ip::tcp;
using boost::system::error_code;
using testing::eventually;
using ::testing::HasSubstr;
using testing::milliseconds;

/// Upgrades one connection, says what it was given to say, and closes or answers each `subscribe`.
class ScriptedBroker {
 public:
  struct Script {
    std::vector<std::string> at_first;
    std::string to_subscribe;  ///< Answer; empty: none.
    bool then_close = false;   ///< After at_first.
  };
  explicit ScriptedBroker(Script script)
      : script_(std::move(script)), acceptor_(loop_, tcp::endpoint(asio::ip::address_v4::loopback(), 0)), link_(loop_) {
    thread_ = std::thread([this] { serve(); });
  }
  ~ScriptedBroker() { thread_.join(); }  ///< REQUIRES: the client is gone.
  std::string url() const {
    return "ws://127.0.0.1:" + std::to_string(acceptor_.local_endpoint().port()) + "/live/ball";
  }
  int subscribes() {
    const std::lock_guard lock(mutex_);
    return subscribes_;
  }

 private:
  void serve() {
    error_code ec;
    acceptor_.accept(link_.next_layer(), ec);
    link_.set_option(beast::websocket::stream_base::decorator(
        [](beast::websocket::response_type& r) { r.set(beast::http::field::sec_websocket_protocol, "eigencast.v1"); }));
    link_.accept(ec);
    for (const std::string& text : script_.at_first) link_.write(asio::buffer(text), ec);
    if (script_.then_close) link_.close(beast::websocket::close_code::service_restart, ec);
    beast::flat_buffer in;
    while (!ec) {
      in.clear();
      link_.read(in, ec);
      const std::string text = beast::buffers_to_string(in.data());
      if (ec || text.find("\"subscribe\"") == std::string::npos) continue;
      {
        const std::lock_guard lock(mutex_);
        ++subscribes_;
      }
      if (!script_.to_subscribe.empty()) link_.write(asio::buffer(script_.to_subscribe), ec);
    }
  }

  const Script script_;
  asio::io_context loop_;
  tcp::acceptor acceptor_;
  beast::websocket::stream<tcp::socket, false> link_;
  std::mutex mutex_;
  int subscribes_ = 0;  ///< GUARDED_BY(mutex_)
  std::thread thread_;
};

const std::string kWaiting = R"({"op":"stream","stream":"live/ball","state":"waiting","stream_id":7,"epoch":0})";
const std::string kDeclined = R"({"op":"error","code":"refused","message":"no room","stream":"live/ball"})";
const std::string kBye = R"({"op":"bye","reason":"upgrade","retry_after_ms":60000})";

/// The pause that a text announces; -1 if it announces none.
long next_try_ms(const std::string& detail) {
  const std::string words = "next try in ";
  const auto at = detail.find(words);
  if (at == std::string::npos) return -1;
  const std::string wait = detail.substr(at + words.size());
  return std::lround(std::stod(wait) * (wait.find(" ms") == std::string::npos ? 1000 : 1));
}

std::unique_ptr<Subscriber> subscribe(const ScriptedBroker& broker) {
  SubscriberOptions options;
  options.url = broker.url();
  options.declined_retry = milliseconds(100);
  auto made = Subscriber::create(std::move(options));
  EXPECT_TRUE(made) << made.error().message;
  return std::move(*made);
}

TEST(Subscriber, AsksAgainForAStreamThatWasRefused) {
  ScriptedBroker broker({{kWaiting, kDeclined}, kWaiting, false});
  const auto subscriber = subscribe(broker);
  bool refused = false;
  ASSERT_TRUE(eventually([&] {
    (void)subscriber->poll(milliseconds(1));
    const auto stats = subscriber->stats();
    if (stats.state == Subscriber::State::kRefused) {
      refused = true;
      EXPECT_FALSE(subscriber->info());
      EXPECT_THAT(stats.detail, HasSubstr("no room"));
      EXPECT_EQ(next_try_ms(stats.detail), 100);
    }
    return broker.subscribes() == 1 && stats.state == Subscriber::State::kWaiting;
  }));
  EXPECT_TRUE(refused);
  EXPECT_TRUE(subscriber->info());
}

TEST(Subscriber, StaysAwayAsLongAsTheBrokerAsks) {
  ScriptedBroker broker({{kWaiting, kBye}, "", true});
  const auto subscriber = subscribe(broker);
  ASSERT_TRUE(eventually(
      [&] { return (void)subscriber->poll(milliseconds(1)), subscriber->stats().state == Subscriber::State::kLost; }));
  EXPECT_GE(next_try_ms(subscriber->stats().detail), 60000);
}

TEST(Publisher, StaysAwayAsLongAsTheBrokerAsks) {
  auto baked = bake(make_icosphere(1), {.basis = "augmented", .rank = 8, .name = "ball"});
  ASSERT_TRUE(baked) << baked.error().message;
  ScriptedBroker broker({{kBye}, "", true});
  PublisherOptions options;
  options.url = broker.url();
  auto publisher = Publisher::create(options, std::make_shared<const Asset>(std::move(baked->asset)),
                                     std::make_shared<const EncodedAsset>(std::move(baked->encoded)));
  ASSERT_TRUE(publisher) << publisher.error().message;
  EXPECT_TRUE(eventually([&] { return next_try_ms((*publisher)->stats().detail) >= 60000; }))
      << (*publisher)->stats().detail;
}

}  // namespace
}  // namespace eigencast
