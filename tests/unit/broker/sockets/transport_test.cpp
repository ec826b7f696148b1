// SPDX-License-Identifier: MIT
#include "broker/sockets/transport.h"

#include <gtest/gtest.h>

#include <boost/asio/read.hpp>
#include <string>

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

}  // namespace
}  // namespace eigencast::broker
