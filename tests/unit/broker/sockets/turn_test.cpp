// SPDX-License-Identifier: MIT
#include "broker/sockets/turn.h"

#include <gtest/gtest.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <boost/asio/buffer.hpp>
#include <boost/asio/read.hpp>
#include <iterator>
#include <new>
#include <optional>
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
  void sent(const Transport::Outcome&) override {}
  const void* purse() const override { return nullptr; }
  double write_us() const override { return 1; }

  bool deliver() {
    steps_.push_back("deliver");
    if (std::exchange(fails_, false)) throw std::bad_alloc();
    if (has_output_) turn_.add(*this, false);
    return false;
  }

  Steps steps_;
  bool has_output_ = false, fails_ = false;
  asio::io_context loop_{1};
  Turn turn_{loop_, Turn::Settings{}, LogSink{}, [this] { return deliver(); }};
};

TEST_F(TurnTest, FlushesOnceAfterDelivery) {
  turn_.add(*this, false);
  turn_.add(*this, false);
  has_output_ = true;
  asio::post(loop_, [this] { steps_.push_back("another"); });
  loop_.run();
  EXPECT_EQ(steps_, (Steps{"deliver", "flush", "another"}));
}

TEST_F(TurnTest, TurnEndsAfterReadyHandlers) {
  asio::post(loop_, [this] {
    turn_.now_us();
    asio::post(loop_, [this] { steps_.push_back("next turn's"); });
  });
  asio::post(loop_, [this] { turn_.add(*this, false); });
  loop_.run();
  EXPECT_EQ(steps_, (Steps{"deliver", "flush", "next turn's"}));
}

TEST_F(TurnTest, FailedTurnIsRetriedWithItsWrites) {
  fails_ = true;
  turn_.add(*this, false);
  EXPECT_THROW(loop_.run(), std::bad_alloc);
  EXPECT_EQ(steps_, Steps{"deliver"});
  turn_.now_us();
  loop_.restart();
  loop_.run();
  EXPECT_EQ(steps_, (Steps{"deliver", "deliver", "flush"}));
}

TEST_F(TurnTest, WritesAtOnceEndWithTheTimeThatTheyTake) {
  for (unsigned i = 0; i < kMaxBatch / 2; ++i) turn_.note_written_at_once(0);
  EXPECT_TRUE(turn_.writes_at_once()) << "half of the short ones";
  for (unsigned i = 0; i < kMaxBatch / 20; ++i) turn_.note_written_at_once(10 * kBytesOfWrite);
  EXPECT_FALSE(turn_.writes_at_once()) << "and a few long ones";
}

/// One of a holder, whose writes take a part of a slice.
struct Held final : SocketWriter {
  Held(std::vector<const Held*>& all, const void* owner, double part) : order(all), holder(owner), us(part) {}
  void flush() override { order.push_back(this); }
  int plain_socket() override { return -1; }
  std::size_t pieces(std::span<iovec>) override { return 0; }
  void written(const Transport::Outcome&) override {}
  void sent(const Transport::Outcome&) override {}
  const void* purse() const override { return holder; }
  double write_us() const override { return us; }
  std::vector<const Held*>& order;
  const void* holder;
  double us;
};

/// A crowd of some holders, and one who comes when it waits already.
TEST(TurnShares, ACrowdIsWrittenInSlicesAndDelaysOthersByOneSlice) {
  constexpr std::size_t kHolders = 4, kOfSlice = 10;
  asio::io_context loop{1};
  Turn turn(loop, Turn::Settings{}, LogSink{}, [] { return false; });
  std::vector<const Held*> order;
  const std::array<int, kHolders> holders{};
  std::vector<Held> crowd;
  for (std::size_t i = 0; i < 100; ++i) crowd.emplace_back(order, &holders[i % kHolders], Turn::kSliceUs / kOfSlice);
  Held innocent(order, &innocent, 5);
  for (Held& writer : crowd) turn.add(writer, false);
  loop.run_one();
  EXPECT_EQ(order.size(), kOfSlice) << "of a turn";
  EXPECT_TRUE(Turn::is_late(crowd.back()));
  EXPECT_FALSE(turn.writes_at_once()) << "nobody overtakes those who wait";
  turn.add(innocent, false);
  turn.add(crowd.back(), false);
  turn.forget(crowd[50]);
  loop.run_one();
  const auto came = std::find(order.begin() + kOfSlice, order.end(), &innocent);
  EXPECT_LE(came - order.begin(), static_cast<std::ptrdiff_t>(kOfSlice + kHolders)) << "one of each holder before it";
  loop.run();
  EXPECT_EQ(order.size(), crowd.size()) << "all but the forgotten one, once each, and the innocent one";
  EXPECT_TRUE(turn.writes_at_once());
  std::vector<const Held*> of_first;
  std::copy_if(order.begin(), order.end(), std::back_inserter(of_first),
               [&](const Held* writer) { return writer->holder == &holders[0]; });
  EXPECT_TRUE(std::is_sorted(of_first.begin(), of_first.end())) << "a holder's keep their order";
}

/// One that is sent to: keeps what it is told.
struct Told final : SocketWriter {
  void flush() override {}
  int plain_socket() override { return -1; }
  std::size_t pieces(std::span<iovec>) override { return 0; }
  void written(const Transport::Outcome&) override {}
  void sent(const Transport::Outcome& what) override { outcome = what; }
  const void* purse() const override { return nullptr; }
  double write_us() const override { return 1; }
  std::optional<Transport::Outcome> outcome;
};

class BatchTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (auto ring = open_uring(); !ring) GTEST_SKIP() << "no io_uring: " << ring.error().message;
    turn_.begin();
  }

  /// A socket of loopback, and its peer, which reads nothing until asked.
  struct Pair {
    explicit Pair(asio::io_context& loop) : ours(loop.get_executor()), peer(loop.get_executor()) {
      Acceptor acceptor(loop.get_executor(), {asio::ip::address_v4::loopback(), 0});
      peer.connect(acceptor.local_endpoint());
      ours = acceptor.accept();
    }
    std::size_t read(std::size_t bytes) {
      std::vector<char> into(bytes);
      boost::system::error_code error;  // The ring's signals interrupt MSG_WAITALL.
      return asio::read(peer, asio::buffer(into), error);
    }
    Socket ours, peer;
  };

  void send(Told& writer, Pair& pair, const std::shared_ptr<const Bytes>& bytes, bool tell = false) {
    turn_.send(writer, pair.ours.native_handle(), *bytes, bytes, tell);
  }

  asio::io_context loop_{1};
  Turn turn_{loop_, Turn::Settings{}, LogSink{}, [] { return false; }};
};

TEST_F(BatchTest, TellsOfFailuresAndWhereAskedFor) {
  Pair good(loop_), asked(loop_), full(loop_), broken(loop_);
  ::shutdown(broken.ours.native_handle(), SHUT_WR);
  Told all, wanted, partly, none;
  const auto small = std::make_shared<const Bytes>(600), large = std::make_shared<const Bytes>(64 << 20);
  send(all, good, small);
  send(wanted, asked, small, true);
  send(partly, full, large);
  send(none, broken, small);
  EXPECT_TRUE(turn_.is_sending(all));
  turn_.submit();
  EXPECT_FALSE(turn_.is_sending(all));
  EXPECT_EQ(good.read(600), 600u);
  EXPECT_FALSE(all.outcome);
  ASSERT_TRUE(wanted.outcome);
  EXPECT_EQ(wanted.outcome->bytes, 600u);
  ASSERT_TRUE(partly.outcome);
  EXPECT_GT(partly.outcome->bytes, 0u);
  EXPECT_LT(partly.outcome->bytes, large->size());
  EXPECT_FALSE(partly.outcome->error);
  for (partly.outcome.reset(); !partly.outcome; turn_.submit()) send(partly, full, small);  // Buffers may grow.
  EXPECT_LT(partly.outcome->bytes, small->size());
  EXPECT_EQ(partly.outcome->wait, Transport::Wait::kWritable);
  ASSERT_TRUE(none.outcome);
  EXPECT_TRUE(none.outcome->error);
  EXPECT_EQ(small.use_count() + large.use_count(), 2);
}

TEST_F(BatchTest, FlushesWhenTurnEndsOrFull) {
  Pair pair(loop_);
  std::vector<Told> writers(kMaxBatch + 1);
  const auto byte = std::make_shared<const Bytes>(1);
  turn_.now_us();
  for (Told& writer : writers) send(writer, pair, byte);
  EXPECT_FALSE(turn_.is_sending(writers.front()));
  EXPECT_TRUE(turn_.is_sending(writers.back()));
  EXPECT_EQ(pair.read(kMaxBatch), kMaxBatch);
  loop_.run();
  EXPECT_FALSE(turn_.is_sending(writers.back()));
  EXPECT_EQ(pair.read(1), 1u);
}

TEST_F(BatchTest, ForgottenWriterIsFlushedFirst) {
  Pair pair(loop_);
  Told writer;
  send(writer, pair, std::make_shared<const Bytes>(600));
  turn_.forget(writer);
  pair.ours.close();
  EXPECT_EQ(pair.read(601), 600u);
}

}  // namespace
}  // namespace eigencast::broker
