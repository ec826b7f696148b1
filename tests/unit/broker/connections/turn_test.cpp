// SPDX-License-Identifier: MIT
#include "broker/connections/turn.h"

#include <gtest/gtest.h>

#include <new>
#include <string>
#include <vector>

namespace eigencast::broker {
namespace {

using Steps = std::vector<std::string>;

class TurnTest : public ::testing::Test, public Leaver {
 protected:
  void leave() override { steps_.push_back("leave"); }
  int plain_socket() override { return -1; }
  std::size_t pieces(std::span<iovec>) override { return 0; }
  void left(const Transport::Outcome&) override {}

  void deliver() {
    steps_.push_back("deliver");
    if (std::exchange(fails_, false)) throw std::bad_alloc();
    if (owes_) turn_.add(*this, false);
  }

  Steps steps_;
  bool owes_ = false, fails_ = false;
  asio::io_context loop_{1};
  Turn turn_{loop_, Turn::Settings{}, LogSink{}, [this] { deliver(); }, [this] { steps_.push_back("prepare"); }};
};

TEST_F(TurnTest, WhatIsAddedLeavesOnceAfterTheDeliveryAndBeforeThePreparation) {
  turn_.add(*this, false);
  turn_.add(*this, false);
  owes_ = true;
  asio::post(loop_, [this] { steps_.push_back("another"); });
  loop_.run();
  EXPECT_EQ(steps_, (Steps{"deliver", "leave", "prepare", "another"}));
}

TEST_F(TurnTest, ATurnEndsBehindAllThatWasReady) {
  asio::post(loop_, [this] {
    turn_.now_us();
    asio::post(loop_, [this] { steps_.push_back("next turn's"); });
  });
  asio::post(loop_, [this] { turn_.add(*this, false); });
  loop_.run();
  EXPECT_EQ(steps_, (Steps{"deliver", "leave", "prepare", "next turn's"}));
}

TEST_F(TurnTest, AfterOneThatFailedComesANextWithAllThatWasOwed) {
  fails_ = true;
  turn_.add(*this, false);
  EXPECT_THROW(loop_.run(), std::bad_alloc);
  EXPECT_EQ(steps_, Steps{"deliver"});
  turn_.now_us();
  loop_.restart();
  loop_.run();
  EXPECT_EQ(steps_, (Steps{"deliver", "deliver", "leave", "prepare"}));
}

}  // namespace
}  // namespace eigencast::broker
