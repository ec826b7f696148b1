// SPDX-License-Identifier: MIT
#include "broker/sockets/transport.h"

#include <gtest/gtest.h>
#include <netinet/tcp.h>
#include <sys/socket.h>

#include <boost/asio/read.hpp>
#include <boost/asio/write.hpp>
#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "broker/sockets/listener.h"

namespace eigencast::broker {
namespace {

class TransportTest : public ::testing::Test {
 protected:
  TransportTest() : peer_(loop_.get_executor()), transport_(Socket(loop_.get_executor())) {
    Acceptor acceptor(loop_.get_executor(), Tcp::endpoint(asio::ip::address_v4::loopback(), 0));
    peer_.connect(acceptor.local_endpoint());
    acceptor.accept(transport_.socket());
  }
  /// Until the kernel takes no more.
  void fill() {
    const std::string bytes(64 * 1024, 'x');
    const iovec piece{const_cast<char*>(bytes.data()), bytes.size()};
    while (transport_.write({&piece, 1}).wait == Transport::Wait::kNo) {
    }
  }

  asio::io_context loop_;
  Socket peer_;
  Transport transport_;
};

TEST_F(TransportTest, TheKernelHoldsFewUnsentBytes) {
  transport_.limit_unsent(64 * 1024);
  fill();
  EXPECT_GT(transport_.unacknowledged(), 0u);
  EXPECT_LE(transport_.unacknowledged(), 4 * 64 * 1024u) << "and what is on its way";
}

TEST_F(TransportTest, ASendBufferHoldsTwiceItsSizeAndASegment) {
  transport_.limit_send_buffer(32 * 1024);
  fill();
  EXPECT_LE(transport_.unacknowledged(), 2 * 64 * 1024u);
}

TEST_F(TransportTest, AfterAResetThePeerGetsNoMore) {
  fill();
  transport_.reset();
  ErrorOf error;
  std::string all;
  asio::read(peer_, asio::dynamic_buffer(all), error);
  EXPECT_EQ(error, asio::error::connection_reset);
  EXPECT_EQ(transport_.unacknowledged(), 0u);
}

/// Bytes that a peer gets rid of while nobody reads them here.
std::size_t taken(Socket& peer) {
  const std::string some(64 * 1024, 'x');
  ErrorOf error;
  std::size_t bytes = 0;
  peer.non_blocking(true);
  for (int idle = 0; idle < 20;) {
    const std::size_t sent = peer.send(asio::buffer(some), 0, error);
    bytes += sent;
    idle = sent > 0 ? 0 : idle + 1;
    if (sent == 0) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return bytes;
}

class ListenerTest : public ::testing::Test {
 protected:
  ~ListenerTest() override { listener_.close(); }
  void connect() { peer_.connect(Tcp::endpoint(asio::ip::address_v4::loopback(), listener_.port())); }
  void accept() {
    while (!accepted_) loop_.run_one();
  }
  void end() {
    accepted_.reset();
    peer_.close();
    listener_.close();
  }

  asio::io_context loop_;
  std::optional<Transport> accepted_;
  Listener listener_{loop_, {}, [this](Socket socket) { accepted_.emplace(std::move(socket)); }};
  Socket peer_{loop_.get_executor()};
};

int receive_buffer_of(Transport& transport) {
  Socket::receive_buffer_size size;
  transport.socket().get_option(size);
  return size.value();
}

TEST_F(ListenerTest, WhatIsNotReadFillsNoMemory) {
  for (const bool accepts_first : {true, false}) {
    ASSERT_TRUE(listener_.open({"127.0.0.1", 0}));
    connect();
    if (accepts_first) accept();
    (void)taken(peer_);
    if (!accepts_first) accept();
    EXPECT_GT(accepted_->unread(), 0u);
    EXPECT_LE(accepted_->unread(), std::size_t{Transport::kReceiveBytes}) << accepts_first;
    end();
  }
}

/// A window without a scale is 64 KiB at most, so that few bytes come in a round trip, whatever the buffer.
TEST_F(ListenerTest, WindowsHaveAScale) {
  const int handed_over = ::socket(AF_INET, SOCK_STREAM, 0);
  ASSERT_EQ(::listen(handed_over, 1), 0);
  for (const bool adopts : {false, true}) {
    ASSERT_TRUE(adopts ? listener_.adopt(handed_over) : listener_.open({"127.0.0.1", 0}));
    connect();
    accept();
    tcp_info info{};
    socklen_t size = sizeof info;
    ASSERT_EQ(::getsockopt(accepted_->socket().native_handle(), IPPROTO_TCP, TCP_INFO, &info, &size), 0);
    EXPECT_GT(info.tcpi_rcv_wscale, 0u);
    EXPECT_LE(receive_buffer_of(*accepted_), Transport::kReceiveBytes);
    end();
  }
}

/// It grows for who may send much, and no further while that is read.
TEST_F(ListenerTest, SendersHaveMoreRoomAndALimit) {
  const std::pair<std::shared_ptr<void>, int> cases[] = {{nullptr, Transport::kSocketBytes},
                                                         {std::make_shared<int>(), Transport::kWideBytes}};
  for (const auto& [held, most] : cases) {
    ASSERT_TRUE(listener_.open({"127.0.0.1", 0}));
    connect();
    accept();
    accepted_->widen_receive_buffer(held);
    const std::string much(64 << 20, 'x');
    std::thread sends([&] { asio::write(peer_, asio::buffer(much)); });
    std::vector<char> into(much.size());
    asio::read(accepted_->socket(), asio::buffer(into));
    sends.join();
    EXPECT_LE(receive_buffer_of(*accepted_), most);
    EXPECT_GE(receive_buffer_of(*accepted_), most / 2);
    (void)taken(peer_);
    EXPECT_GT(accepted_->unread(), std::size_t(most / 4));
    EXPECT_LE(accepted_->unread(), std::size_t(most) + 64 * 1024) << "and a packet";
    EXPECT_EQ(accepted_->is_wide(), held != nullptr);
    end();
  }
}

}  // namespace
}  // namespace eigencast::broker
