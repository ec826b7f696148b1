// SPDX-License-Identifier: MIT
#include "common/net/http.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/read.hpp>
#include <boost/asio/read_until.hpp>
#include <boost/asio/streambuf.hpp>
#include <boost/asio/write.hpp>
#include <string>
#include <thread>
#include <vector>

#include "common/core/hash/sha256.h"
#include "tests/support/loopback_broker.h"

namespace eigencast {
namespace {

namespace asio = boost::asio;
using asio::ip::tcp;
using ::testing::HasSubstr;
using testing::LoopbackBroker;

Bytes pattern(std::size_t size) {
  Bytes bytes(size);
  for (std::size_t i = 0; i < size; ++i) bytes[i] = static_cast<std::uint8_t>(i * i % 251 + i / 1000);
  return bytes;
}

class HttpToBroker : public ::testing::Test {
 protected:
  HttpConnection connection() { return HttpConnection(*parse_broker_url(broker_.url(""))); }
  std::string put(const Bytes& bytes) {
    const std::string target = "/v1/assets/" + sha256(bytes).hex();
    auto http = connection();
    const auto answer = http.put(target, bytes);
    EXPECT_TRUE(answer) << answer.error().message;
    EXPECT_TRUE(answer && answer->status / 100 == 2);
    return target;
  }
  LoopbackBroker broker_;
};

TEST_F(HttpToBroker, PutHeadGetAndRangesOnOneConnection) {
  const Bytes bytes = pattern(300'000);
  const std::string target = put(bytes);
  auto http = connection();
  const auto head = http.head(target);
  ASSERT_TRUE(head) << head.error().message;
  EXPECT_EQ(head->status, 200);
  EXPECT_EQ(head->content_length, bytes.size());
  EXPECT_TRUE(head->body.empty());
  const auto all = http.get(target, bytes.size());
  ASSERT_TRUE(all) << all.error().message;
  EXPECT_EQ(all->body, bytes);
  EXPECT_THAT(all->etag, HasSubstr(sha256(bytes).hex()));
  Bytes body(bytes.begin(), bytes.begin() + 12345);
  std::uint64_t seen = 0;
  const auto rest = http.get_rest(target, bytes.size(), body, [&](std::uint64_t size) { seen = size; });
  ASSERT_TRUE(rest);
  EXPECT_EQ(rest->status, 206);
  EXPECT_EQ(body, bytes);
  EXPECT_EQ(seen, bytes.size());
}

TEST_F(HttpToBroker, ProbeReturnsWhetherAccessIsGranted) {
  constexpr std::chrono::seconds kSilence{5};
  const auto url = parse_broker_url(broker_.url("a"));
  EXPECT_TRUE(probe(*url, "/v1/publish/a", kSilence));
  EXPECT_TRUE(probe(*url, "/v1/subscribe/a", kSilence));
  const auto elsewhere = probe(*url, "/nothing", kSilence);
  ASSERT_FALSE(elsewhere);
  EXPECT_EQ(elsewhere.error().code, ErrorCode::kUnreachable) << "a server, but not what was asked for";
  auto guess = *url;
  guess.credentials.token = "ect_" + std::string(64, '0');
  const auto refused = probe(guess, "/v1/publish/a", kSilence);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kRefused);
  const auto nobody = probe(*parse_broker_url("ws://127.0.0.1:1/a"), "/v1/publish/a", kSilence);
  ASSERT_FALSE(nobody);
  EXPECT_EQ(nobody.error().code, ErrorCode::kUnreachable);
}

TEST_F(HttpToBroker, EveryHttpStatusIsAValue) {
  auto http = connection();
  const auto answer = http.get("/v1/assets/" + std::string(64, '0'), 1000);
  ASSERT_TRUE(answer) << answer.error().message;
  EXPECT_EQ(answer->status, 404);
  EXPECT_EQ(http.head("/v1/assets/" + std::string(64, '0'))->status, 404);
}

TEST_F(HttpToBroker, BodyOverTheLimitIsRefused) {
  const std::string target = put(pattern(5000));
  auto http = connection();
  const auto answer = http.get(target, 4999);
  ASSERT_FALSE(answer);
  EXPECT_EQ(answer.error().code, ErrorCode::kTooLarge);
  EXPECT_TRUE(http.get(target, 5000)) << "the connection is made anew";
}

TEST_F(HttpToBroker, SurvivesABrokerRestart) {
  const Bytes bytes = pattern(1000);
  const std::string target = put(bytes);
  auto http = connection();
  ASSERT_TRUE(http.get(target, 1000));
  broker_.stop();
  const auto gone = http.get(target, 1000);
  ASSERT_FALSE(gone);
  EXPECT_EQ(gone.error().code, ErrorCode::kUnreachable);
  broker_.start();
  const auto back = http.get(target, 1000);
  ASSERT_TRUE(back) << back.error().message;
  EXPECT_EQ(back->body, bytes);
}

TEST(Http, FileWithoutAuthoritiesIsInvalid) {
  auto url = *parse_broker_url("wss://localhost/a");
  url.credentials.ca_file = "/nonexistent.pem";
  HttpConnection http(url);
  const auto answer = http.get("/", 10);
  EXPECT_EQ(answer.error().code, ErrorCode::kInvalidArgument);
  EXPECT_NE(answer.error().message.find("/nonexistent.pem"), std::string::npos);
}

/// Gives one answer, as written, to each connection in turn, then closes it; remembers the requests' heads.
class ScriptedServer {
 public:
  explicit ScriptedServer(std::vector<std::string> answers)
      : acceptor_(loop_, tcp::endpoint(asio::ip::address_v4::loopback(), 0)),
        thread_([this, a = std::move(answers)] { serve(a); }) {}
  ~ScriptedServer() { thread_.join(); }
  BrokerUrl url() const {
    return *parse_broker_url("ws://127.0.0.1:" + std::to_string(acceptor_.local_endpoint().port()));
  }
  std::vector<std::string> heads;  ///< Read after the last answer only.
  std::atomic<int> requests{0};    ///< Whose head has come.

 private:
  void serve(const std::vector<std::string>& answers) {
    for (const std::string& answer : answers) {
      tcp::socket socket = acceptor_.accept();
      asio::streambuf buffer;
      boost::system::error_code error;
      asio::read_until(socket, buffer, "\r\n\r\n", error);
      heads.emplace_back(asio::buffers_begin(buffer.data()), asio::buffers_end(buffer.data()));
      ++requests;
      asio::write(socket, asio::buffer(answer), error);
      if (answer.empty()) asio::read(socket, buffer, error);  // Silent until the client goes.
    }
  }
  asio::io_context loop_;
  tcp::acceptor acceptor_;
  std::thread thread_;
};

TEST(Http, BrokenDownloadIsResumed) {
  Bytes body;
  std::string second_head;
  {
    ScriptedServer server({"HTTP/1.1 200 OK\r\nContent-Length: 10\r\n\r\nabcd",
                           "HTTP/1.1 206 Partial Content\r\nContent-Length: 6\r\n\r\nefghij"});
    HttpConnection http(server.url());
    const auto broken = http.get_rest("/x", 10, body);
    ASSERT_FALSE(broken);
    EXPECT_EQ(broken.error().code, ErrorCode::kDisconnected);
    EXPECT_EQ(std::string(body.begin(), body.end()), "abcd");
    const auto rest = http.get_rest("/x", 10, body);
    ASSERT_TRUE(rest) << rest.error().message;
    second_head = server.heads.at(1);
  }
  EXPECT_THAT(second_head, HasSubstr("Range: bytes=4-"));
  EXPECT_EQ(std::string(body.begin(), body.end()), "abcdefghij");
}

TEST(Http, IgnoredRangeRestartsTheBody) {
  ScriptedServer server({"HTTP/1.1 200 OK\r\nContent-Length: 4\r\n\r\nabcd"});
  HttpConnection http(server.url());
  Bytes body{'a', 'b'};
  ASSERT_TRUE(http.get_rest("/x", 10, body));
  EXPECT_EQ(std::string(body.begin(), body.end()), "abcd");
}

TEST(Http, ChunkedBodyIsCapped) {
  ScriptedServer server({"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n5\r\nabcde\r\n5\r\nfghij\r\n0\r\n\r\n"});
  HttpConnection http(server.url());
  const auto answer = http.get("/x", 9);
  ASSERT_FALSE(answer);
  EXPECT_EQ(answer.error().code, ErrorCode::kTooLarge);
}

TEST(Http, AbsurdLengthIsRefusedUnread) {
  ScriptedServer server({"HTTP/1.1 200 OK\r\nContent-Length: 18446744073709551615\r\n\r\nabc"});
  HttpConnection http(server.url());
  Bytes body{'x'};
  const auto answer = http.get_rest("/x", 1000, body);
  ASSERT_FALSE(answer);
  EXPECT_EQ(answer.error().code, ErrorCode::kTooLarge);
}

TEST(Http, SilenceTimesOut) {
  ScriptedServer server({""});
  HttpConnection http(server.url(), std::chrono::milliseconds(50));
  const auto answer = http.get("/x", 10);
  ASSERT_FALSE(answer);
  EXPECT_EQ(answer.error().code, ErrorCode::kTimeout);
}

TEST(Http, CancelEndsRunningAndLaterCalls) {
  ScriptedServer server({""});
  HttpConnection http(server.url());
  std::thread other([&] {
    while (server.requests == 0) testing::sleep_for(testing::milliseconds(1));
    http.cancel();
  });
  const auto answer = http.get("/x", 10);
  other.join();
  ASSERT_FALSE(answer);
  EXPECT_EQ(answer.error().code, ErrorCode::kCancelled);
  EXPECT_EQ(http.get("/x", 10).error().code, ErrorCode::kCancelled);
}

}  // namespace
}  // namespace eigencast
