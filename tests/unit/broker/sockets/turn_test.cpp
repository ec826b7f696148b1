// SPDX-License-Identifier: MIT
#include "broker/sockets/turn.h"

#include <gtest/gtest.h>

#include <new>
#include <string>
#include <vector>

namespace eigencast::broker {
namespace {

using Steps = std::vector<std::string>;

class TurnTest : public ::testing::Test, public SocketWriter {
 protected:
  void flush() override { steps_.push_back("flush"); }
  int plain_socket() override { return -1; }
  std::size_t pieces(std::span<iovec>) override { return 0; }
  void written(const Transport::Outcome&) override {}

  void deliver() {
    steps_.push_back("deliver");
    if (std::exchange(fails_, false)) throw std::bad_alloc();
    if (has_output_) turn_.add(*this, false);
  }

  Steps steps_;
  bool has_output_ = false, fails_ = false;
  asio::io_context loop_{1};
  Turn turn_{loop_, Turn::Settings{}, LogSink{}, [this] { deliver(); }, [this] { steps_.push_back("prepare"); }};
};

TEST_F(TurnTest, FlushesOnceBetweenDeliverAndPrepare) {
  turn_.add(*this, false);
  turn_.add(*this, false);
  has_output_ = true;
  asio::post(loop_, [this] { steps_.push_back("another"); });
  loop_.run();
  EXPECT_EQ(steps_, (Steps{"deliver", "flush", "prepare", "another"}));
}

TEST_F(TurnTest, TurnEndsAfterReadyHandlers) {
  asio::post(loop_, [this] {
    turn_.now_us();
    asio::post(loop_, [this] { steps_.push_back("next turn's"); });
  });
  asio::post(loop_, [this] { turn_.add(*this, false); });
  loop_.run();
  EXPECT_EQ(steps_, (Steps{"deliver", "flush", "prepare", "next turn's"}));
}

TEST_F(TurnTest, FailedTurnIsRetriedWithItsWrites) {
  fails_ = true;
  turn_.add(*this, false);
  EXPECT_THROW(loop_.run(), std::bad_alloc);
  EXPECT_EQ(steps_, Steps{"deliver"});
  turn_.now_us();
  loop_.restart();
  loop_.run();
  EXPECT_EQ(steps_, (Steps{"deliver", "deliver", "flush", "prepare"}));
}

}  // namespace
}  // namespace eigencast::broker
