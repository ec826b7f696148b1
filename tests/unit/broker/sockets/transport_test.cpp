// SPDX-License-Identifier: MIT
#include "broker/sockets/transport.h"

#include <gtest/gtest.h>

#include <boost/asio/read.hpp>
#include <boost/asio/write.hpp>
#include <chrono>
#include <string>
#include <thread>
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

TEST(ListenerTest, WhatIsNotReadFillsNoMemory) {
  asio::io_context loop;
  std::vector<Transport> accepted;
  Listener listener(loop, {}, [&](Socket socket) { accepted.emplace_back(std::move(socket)); });
  ASSERT_TRUE(listener.open({"127.0.0.1", 0}));
  std::vector<Socket> peers;
  for (int i = 0; i < 2; ++i) {
    peers.emplace_back(loop.get_executor()).connect(Tcp::endpoint(asio::ip::address_v4::loopback(), listener.port()));
  }
  while (accepted.size() < 2) loop.run_one();
  for (Transport& transport : accepted) transport.limit_send_buffer(0);
  (void)taken(peers[0]);
  EXPECT_GT(accepted[0].unread(), 0u);
  EXPECT_LE(accepted[0].unread(), 2u * Listener::kReceiveBytes);
  // It grows for who may send much, and is read.
  accepted[1].widen_receive_buffer();
  const std::string much(64 << 20, 'x');
  std::thread sends([&] { asio::write(peers[1], asio::buffer(much)); });
  std::vector<char> into(much.size());
  asio::read(accepted[1].socket(), asio::buffer(into));
  sends.join();
  Socket::receive_buffer_size size;
  accepted[1].socket().get_option(size);
  EXPECT_GT(size.value(), 4 * Listener::kReceiveBytes);
  listener.close();
}

}  // namespace
}  // namespace eigencast::broker
