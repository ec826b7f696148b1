// SPDX-License-Identifier: MIT
#include <arpa/inet.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <csignal>
#include <memory>
#include <thread>

#include "tests/system/access_scene.h"

// Limits, rights and timeouts as a stranger on the network meets them.
namespace eigencast::testing {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

/// Bytes to the broker and back.
class Wire {
 public:
  explicit Wire(const std::string& port) : socket_(::socket(AF_INET, SOCK_STREAM, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    address.sin_port = htons(static_cast<std::uint16_t>(std::stoi(port)));
    EXPECT_EQ(::connect(socket_, static_cast<sockaddr*>(static_cast<void*>(&address)), sizeof(address)), 0);
  }
  ~Wire() { ::close(socket_); }
  Wire(const Wire&) = delete;
  Wire& operator=(const Wire&) = delete;

  void send(const std::string& text) {
    EXPECT_EQ(::send(socket_, text.data(), text.size(), MSG_NOSIGNAL), static_cast<ssize_t>(text.size()));
  }
  /// All that comes until `text` is part of it, or the broker closes.
  std::string read_until(const std::string& text) {
    while (got_.find(text) == std::string::npos && read()) {
    }
    return got_;
  }
  /// Whether the broker closes by itself; pings of it are not answered.
  bool is_closed() {
    while (read()) {
    }
    return closed_;
  }

 private:
  bool read() {
    pollfd waiting{socket_, POLLIN, 0};
    if (::poll(&waiting, 1, kPatience.count()) != 1) return false;
    char buffer[4096];
    const ssize_t count = ::recv(socket_, buffer, sizeof(buffer), 0);
    closed_ = count <= 0;
    if (count > 0) got_.append(buffer, static_cast<std::size_t>(count));
    return count > 0;
  }
  int socket_;
  bool closed_ = false;
  std::string got_;
};

std::string upgrade_of(const std::string& path, const std::string& headers = {}) {
  return "GET " + path +
         " HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
         "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: eigencast.v2\r\n" +
         headers + "\r\n";
}

class LimitsTest : public AccessTest {
 protected:
  void SetUp() override {
    AccessTest::SetUp();
    write_secret(scene_.file("eigencast.toml"),
                 "[access]\njwt_keys = [\"main HS256 " + scene_.file("main.secret") + "\"]\n");
  }
  /// What one request is answered.
  std::string answer(const std::string& request) {
    Wire wire(scene_.port());
    wire.send(request);
    return wire.read_until("\r\n\r\n");
  }
  std::string bearer(const std::string& name, std::vector<std::string> rights) {
    const std::string made = text_of(token(name, std::move(rights)).substr(1));
    return "Authorization: Bearer " + made.substr(0, made.find('\n')) + "\r\n";
  }
};

TEST_F(LimitsTest, RightsHoldAtEveryEndpoint) {
  write_secret(scene_.file("eigencast.toml"),
               "[access]\nanonymous = \"nowhere\"\njwt_keys = [\"main HS256 " + scene_.file("main.secret") + "\"]\n");
  auto broker = scene_.start_broker(configured());
  const std::string sends = bearer("sends", {"--publish", "lab/*"});
  const std::string views = bearer("views", {"--subscribe", "lab/*"});
  const std::string runs = bearer("runs", {"--admin"});
  EXPECT_THAT(answer(upgrade_of("/v1/publish/lab/a", sends)), HasSubstr(" 101 "));
  EXPECT_THAT(answer(upgrade_of("/v1/publish/live/a", sends)), HasSubstr(" 403 "));
  EXPECT_THAT(answer(upgrade_of("/v1/publish/lab/a", views)), HasSubstr(" 403 "));
  EXPECT_THAT(answer(upgrade_of("/v1/publish/lab/a", runs)), HasSubstr(" 403 "));
  EXPECT_THAT(answer(upgrade_of("/v1/subscribe/lab/a", views)), HasSubstr(" 101 "));
  EXPECT_THAT(answer(upgrade_of("/v1/subscribe/other", views)), HasSubstr(" 403 "));
  EXPECT_THAT(answer(upgrade_of("/v1/subscribe/lab/a", sends)), HasSubstr(" 403 "));
  EXPECT_THAT(answer(upgrade_of("/v1/subscribe/lab/a")), HasSubstr(" 401 "));
  const std::string asset = "/v1/assets/" + std::string(64, 'a');
  const auto http = [](const std::string& method, const std::string& path, const std::string& headers) {
    return method + " " + path + " HTTP/1.1\r\nHost: localhost\r\nContent-Length: 0\r\n" + headers + "\r\n";
  };
  EXPECT_THAT(answer(http("GET", asset, views)), HasSubstr(" 404 ")) << "it may ask";
  EXPECT_THAT(answer(http("GET", asset, "")), HasSubstr(" 401 "));
  EXPECT_THAT(answer(http("GET", "/v1/publish/lab/a", sends)), HasSubstr(" 426 ")) << "it may, with an upgrade";
  EXPECT_THAT(answer(http("GET", "/v1/publish/live/a", sends)), HasSubstr(" 403 ")) << "nor with one";
  EXPECT_THAT(answer(http("GET", "/v1/subscribe/other", views)), HasSubstr(" 403 "));
  EXPECT_THAT(answer(http("PUT", asset, views)), HasSubstr(" 403 "));
  EXPECT_THAT(answer(http("PUT", asset, sends)), HasSubstr(" 422 "))
      << "it may send; what it sent is not what its name says";
  EXPECT_THAT(answer(http("GET", "/v1/streams", "")), HasSubstr(" 401 "));
  EXPECT_THAT(answer(http("GET", "/v1/streams", views + "Origin: https://elsewhere.example\r\n")), HasSubstr(" 403 "));
  EXPECT_THAT(answer(http("GET", "/v1/streams", views)), HasSubstr(" 200 "));
}

TEST_F(LimitsTest, OneConnectionTooManyIsRefused) {
  auto broker = scene_.start_broker(configured({"--per-address-connections", "2", "--per-token-connections", "1"}));
  Wire first(scene_.port());
  first.send(upgrade_of("/v1/subscribe", bearer("views", {"--subscribe", "**"})));
  EXPECT_THAT(first.read_until("welcome"), HasSubstr(" 101 "));
  const std::string of_token = answer(upgrade_of("/v1/subscribe", bearer("views", {"--subscribe", "**"})));
  EXPECT_THAT(of_token, HasSubstr(" 429 "));
  EXPECT_THAT(of_token, HasSubstr("Retry-After"));
  // The one that was just turned away may count for a moment longer.
  std::unique_ptr<Wire> second;
  EXPECT_TRUE(eventually([&] {
    second = std::make_unique<Wire>(scene_.port());
    second->send(upgrade_of("/v1/subscribe"));
    return second->read_until("\r\n\r\n").find(" 101 ") != std::string::npos;
  }));
  EXPECT_THAT(answer(upgrade_of("/v1/subscribe")), HasSubstr(" 429 "));
  EXPECT_THAT(refusal("refused", {}, "2"), HasSubstr("per_address.connections"));
}

TEST_F(LimitsTest, SendersStreamsMessagesAndUploadsAreLimited) {
  auto broker = scene_.start_broker(
      configured({"--per-address-publishers", "1", "--per-address-streams", "1", "--per-address-messages-per-s", "20",
                  "--per-address-upload-bytes-per-hour", "1000"}));
  {
    Wire sender(scene_.port());
    sender.send(upgrade_of("/v1/publish/a"));
    EXPECT_THAT(sender.read_until("welcome"), HasSubstr(" 101 "));
    EXPECT_THAT(answer(upgrade_of("/v1/publish/b")), HasSubstr(" 429 "));
    Wire viewer(scene_.port());
    viewer.send(upgrade_of("/v1/subscribe/a"));
    EXPECT_THAT(viewer.read_until("welcome"), HasSubstr(" 101 "));
    Wire other(scene_.port());
    other.send(upgrade_of("/v1/subscribe/b"));
    EXPECT_THAT(other.read_until("per_address.streams = 1"), HasSubstr("per_address.streams = 1"));
    // Empty pings, masked: 6 bytes each, thousands a second.
    std::string pings;
    for (int i = 0; i < 200; ++i) pings += std::string("\x89\x80\0\0\0\0", 6);
    viewer.send(pings);
    EXPECT_THAT(viewer.read_until("messages_per_s = 20"), HasSubstr("per_address.messages_per_s = 20"));
    EXPECT_TRUE(viewer.is_closed());
    EXPECT_TRUE(broker->wait_for_output("messages_per_s", kPatience)) << scene_.logs();
  }
  auto sender = scene_.start_sender({"torus", "--rate", "30"});
  EXPECT_TRUE(broker->wait_for_output("upload_bytes_per_hour", kPatience)) << scene_.logs();
  EXPECT_TRUE(sender->wait_for_output("upload_bytes_per_hour", kPatience)) << scene_.logs();
}

TEST_F(LimitsTest, GuessedTokensAreRateLimited) {
  auto broker = scene_.start_broker(configured({"--access-failures-per-minute", "2"}));
  const std::string guess = "Authorization: Bearer ect_" + std::string(64, '1') + "\r\n";
  EXPECT_THAT(answer(upgrade_of("/v1/subscribe", guess)), HasSubstr(" 401 "));
  EXPECT_THAT(answer(upgrade_of("/v1/subscribe", guess)), HasSubstr(" 401 "));
  const std::string slowed = answer(upgrade_of("/v1/subscribe", guess));
  EXPECT_THAT(slowed, HasSubstr(" 429 "));
  EXPECT_THAT(slowed, HasSubstr("Retry-After"));
  EXPECT_THAT(answer(upgrade_of("/v1/subscribe", bearer("views", {"--subscribe", "**"}))), HasSubstr(" 101 "))
      << "others' wrong tokens lock nobody out";
  EXPECT_THAT(answer(upgrade_of("/v1/subscribe")), HasSubstr(" 101 ")) << "a client that guesses nothing goes on";
  EXPECT_THAT(broker->output(), Not(HasSubstr("ect_1")));
}

TEST_F(LimitsTest, SilenceEndsConnections) {
  auto broker = scene_.start_broker(configured({"--timeouts-header-ms", "300", "--timeouts-idle-ms", "1000"}));
  Wire silent(scene_.port());
  EXPECT_TRUE(silent.is_closed()) << "no request";
  Wire slow(scene_.port());
  slow.send("GET /v1/streams HTTP/1.1\r\nHost: ");
  EXPECT_TRUE(slow.is_closed()) << "half a request";
  std::unique_ptr<Wire> viewer;
  EXPECT_TRUE(eventually([&] {  // A busy machine may be silent for as long itself.
    viewer = std::make_unique<Wire>(scene_.port());
    viewer->send(upgrade_of("/v1/subscribe"));
    return viewer->read_until("welcome").find(" 101 ") != std::string::npos;
  }));
  EXPECT_TRUE(viewer->is_closed()) << "its pings are not answered";
}

TEST_F(LimitsTest, SilenceBeforeTheTlsHandshakeEndsConnectionsToo) {
  if (!make_certificate(scene_, "good")) GTEST_SKIP() << "no openssl";
  auto arguments = with_tls("good");
  arguments.insert(arguments.end(), {"--timeouts-header-ms", "300"});
  auto broker = scene_.start_broker(arguments);
  Wire silent(scene_.port());
  EXPECT_TRUE(silent.is_closed());
  Wire plain(scene_.port());
  plain.send("GET /v1/streams HTTP/1.1\r\nHost: localhost\r\n\r\n");
  EXPECT_TRUE(plain.is_closed()) << "it speaks no TLS";
}

TEST_F(LimitsTest, AReloadAppliesEverythingOrNothing) {
  auto broker = scene_.start_broker(configured());
  const std::string before = text_of(scene_.file("eigencast.toml"));
  write_secret(scene_.file("eigencast.toml"), before + "[limits]\nmax_stream = 7\n");
  ASSERT_FALSE(reloads(*broker)) << scene_.logs();
  EXPECT_TRUE(broker->wait_for_output("'limits.max_streams'", kPatience)) << scene_.logs();
  Wire viewer(scene_.port());
  viewer.send(upgrade_of("/v1/subscribe"));
  EXPECT_THAT(viewer.read_until("welcome"), HasSubstr(" 101 "));

  // A client that is no longer admitted gets the reason, and its connection ends.
  write_secret(scene_.file("eigencast.toml"), before + "anonymous = \"nowhere\"\n[limits]\nmax_streams = 7\n");
  ASSERT_TRUE(reloads(*broker)) << scene_.logs();
  EXPECT_TRUE(broker->wait_for_output("limits.max_streams = 7", kPatience)) << scene_.logs();
  EXPECT_TRUE(broker->wait_for_output("access.anonymous = \"nowhere\"", kPatience)) << scene_.logs();
  EXPECT_THAT(viewer.read_until("retry_after_ms"), HasSubstr("\"op\":\"bye\""));
  EXPECT_TRUE(viewer.is_closed());
  EXPECT_THAT(answer(upgrade_of("/v1/subscribe")), HasSubstr(" 401 "));
}

TEST_F(LimitsTest, AReloadSuitsTheAddressThatIsInUse) {
  const std::string toml = scene_.file("eigencast.toml");
  const std::string whole = "[server]\nlisten = \"0.0.0.0:0\"\n" + text_of(toml);
  write_secret(toml, whole);
  // Without --listen and its value.
  auto broker = scene_.start_broker(configured(), {"sh", "-c", "shift 2; exec \"$0\" \"$@\""});
  for (const char* half : {"", "[server]\n"}) {  // As a program that writes it anew leaves it for a moment.
    write_secret(toml, half);
    EXPECT_FALSE(reloads(*broker)) << half << scene_.logs();
  }
  write_secret(toml, whole);
  EXPECT_TRUE(reloads(*broker)) << scene_.logs();
}

TEST_F(LimitsTest, ABrokerThatWasStoppedAsksBeforeItCloses) {
  auto broker = scene_.start_broker(configured({"--access-anonymous", "loopback", "--timeouts-idle-ms", "6000"}));
  Wire viewer(scene_.port());
  viewer.send(upgrade_of("/v1/subscribe"));
  viewer.read_until("welcome");
  broker->signal(SIGSTOP);
  std::this_thread::sleep_for(std::chrono::seconds(7));
  broker->signal(SIGCONT);
  const std::string ping("\x89\0", 2);
  EXPECT_THAT(viewer.read_until(ping), HasSubstr(ping)) << "it could not answer what nobody asked";
}

}  // namespace
}  // namespace eigencast::testing
