// SPDX-License-Identifier: MIT
#include "tests/support/impaired_relay.h"

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <thread>
#include <vector>

#include "tests/support/process.h"

namespace eigencast::testing {
namespace {

sockaddr_in loopback(std::uint16_t port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  address.sin_port = htons(port);
  return address;
}

bool send_all(int fd, const std::uint8_t* data, std::size_t size) {
  while (size > 0) {
    const ssize_t sent = ::send(fd, data, size, MSG_NOSIGNAL);
    if (sent <= 0) return false;
    data += sent;
    size -= static_cast<std::size_t>(sent);
  }
  return true;
}

std::vector<std::uint8_t> receive(int fd, std::size_t size) {
  std::vector<std::uint8_t> got;
  std::uint8_t part[4096];
  while (got.size() < size) {
    const ssize_t count = ::recv(fd, part, sizeof part, 0);
    if (count <= 0) break;
    got.insert(got.end(), part, part + count);
  }
  return got;
}

/// Sends back what one connection sends, until that ends.
class EchoServer {
 public:
  EchoServer() : listener_(::socket(AF_INET, SOCK_STREAM, 0)) {
    sockaddr_in address = loopback(0);
    socklen_t size = sizeof address;
    EXPECT_EQ(::bind(listener_, reinterpret_cast<sockaddr*>(&address), size), 0);
    EXPECT_EQ(::listen(listener_, 4), 0);
    getsockname(listener_, reinterpret_cast<sockaddr*>(&address), &size);
    port_ = ntohs(address.sin_port);
    thread_ = std::thread([this] {
      const int fd = ::accept(listener_, nullptr, nullptr);
      std::uint8_t part[4096];
      for (ssize_t count; fd >= 0 && (count = ::recv(fd, part, sizeof part, 0)) > 0;)
        if (!send_all(fd, part, static_cast<std::size_t>(count))) break;
      if (fd >= 0) ::close(fd);
    });
  }
  ~EchoServer() {
    ::shutdown(listener_, SHUT_RDWR);
    thread_.join();
    ::close(listener_);
  }
  std::uint16_t port() const { return port_; }

 private:
  int listener_;
  std::uint16_t port_ = 0;
  std::thread thread_;
};

class Connection {
 public:
  explicit Connection(std::uint16_t port) : fd(::socket(AF_INET, SOCK_STREAM, 0)) {
    const sockaddr_in address = loopback(port);
    EXPECT_EQ(::connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
  }
  ~Connection() { ::close(fd); }
  const int fd;
};

std::vector<std::uint8_t> pattern(std::size_t size) {
  std::vector<std::uint8_t> bytes(size);
  std::uint32_t state = 1;
  for (auto& byte : bytes) byte = static_cast<std::uint8_t>((state = state * 1664525 + 1013904223) >> 24);
  return bytes;
}

TEST(ImpairedRelay, BytesArriveOnceInOrder) {
  EchoServer server;
  ImpairedRelay::Options options;
  options.target_port = server.port();
  options.to_target = {.delay_us = 2000, .jitter_us = 2000, .loss = 0.05, .retransmit_us = 3000};
  options.from_target = {.delay_us = 1000, .jitter_us = 1000, .rate_bit_per_s = 80e6};
  auto relay = ImpairedRelay::start(options);
  ASSERT_TRUE(relay) << relay.error().message;
  Connection connection((*relay)->port());
  const auto sent = pattern(400'000);
  std::thread sender([&] { EXPECT_TRUE(send_all(connection.fd, sent.data(), sent.size())); });
  EXPECT_EQ(receive(connection.fd, sent.size()), sent);
  sender.join();
  // The relay counts after it has written.
  EXPECT_TRUE(eventually([&] { return (*relay)->bytes_from_target() == sent.size(); }));
  EXPECT_EQ((*relay)->bytes_to_target(), sent.size());
}

TEST(ImpairedRelay, NothingArrivesEarly) {
  EchoServer server;
  ImpairedRelay::Options options;
  options.target_port = server.port();
  options.to_target = {.delay_us = 20'000};
  options.from_target = {.delay_us = 10'000, .rate_bit_per_s = 8e6};
  auto relay = ImpairedRelay::start(options);
  ASSERT_TRUE(relay) << relay.error().message;
  Connection connection((*relay)->port());
  const auto sent = pattern(50'000);
  const TimeUs start = steady_now_us();
  std::thread sender([&] { EXPECT_TRUE(send_all(connection.fd, sent.data(), sent.size())); });
  EXPECT_EQ(receive(connection.fd, sent.size()), sent);
  sender.join();
  EXPECT_GE(steady_now_us() - start, 20'000 + 10'000 + 50'000);
}

TEST(ImpairedRelay, EndOfStreamFollowsItsBytes) {
  EchoServer server;
  ImpairedRelay::Options options;
  options.target_port = server.port();
  options.to_target = options.from_target = {.delay_us = 5000};
  auto relay = ImpairedRelay::start(options);
  ASSERT_TRUE(relay) << relay.error().message;
  Connection connection((*relay)->port());
  const auto sent = pattern(3000);
  ASSERT_TRUE(send_all(connection.fd, sent.data(), sent.size()));
  ::shutdown(connection.fd, SHUT_WR);
  EXPECT_EQ(receive(connection.fd, sent.size() + 1), sent) << "all, then the end";
}

TEST(ImpairedRelay, AnImpossibleLinkIsRefused) {
  ImpairedRelay::Options options;
  options.from_target.loss = 2;
  EXPECT_FALSE(ImpairedRelay::start(options));
}

}  // namespace
}  // namespace eigencast::testing
