// SPDX-License-Identifier: MIT
#include "broker/connections/connection.h"

#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <boost/asio/thread_pool.hpp>
#include <chrono>
#include <deque>
#include <future>
#include <thread>
#include <utility>

#include "broker/connections/rewind.h"
#include "broker/loops/loops.h"
#include "broker/relay/fair_reads.h"
#include "broker/relay/ownership.h"
#include "broker/storage/asset_store.h"
#include "broker/storage/history.h"
#include "broker/storage/recorder.h"
#include "broker/websocket/protocol.h"
#include "tests/support/process.h"

namespace eigencast::broker {
namespace {

/// Counts messages.
class Counting final : public Connection {
 public:
  Counting(Context& context, Transport transport, GrantPtr grant)
      : Connection(context, std::move(transport), std::move(grant), {2048, 2048}) {}
  using Connection::send;

  int messages = 0, messages_when_closed = -1;

 private:
  void on_open() override {}
  void on_message(const ControlMessage&) override { ++messages; }
  void on_binary(ByteView) override {}
  void on_closed() override { messages_when_closed = messages; }
  std::string label() const override { return "test"; }
};

std::string masked_text(std::string_view text) {
  Bytes head;
  websocket::append_header(websocket::Opcode::kText, text.size(), head);
  head[1] |= 0x80;
  return std::string(head.begin(), head.end()) + std::string(4, '\0') + std::string(text);
}

/// One event loop, which the test runs, and the other end of a connection.
class ConnectionTest : public ::testing::Test {
 protected:
  Context& begin() {
    loops_ = std::make_unique<Loops>(
        config_,
        SharedContext{disk_, disk_, gate_, *assets_, recorder_, history_, ownership_, nullptr, {}, "test", "session"},
        std::vector<StreamTap*>{});
    loops_->first().begin();
    return loops_->first().context();
  }
  std::shared_ptr<Counting> connect() {
    EXPECT_EQ(::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends_.data()), 0);
    Context& context = begin();
    Socket socket(context.loop.get_executor());
    socket.assign(Tcp::v4(), ends_[1]);
    auto grant = gate_.accept(IpAddress::from_text("127.0.0.1").value(), 0, steady_now_us());
    auto connection =
        std::make_shared<Counting>(context, Transport(std::move(socket)), std::get<GrantPtr>(std::move(grant)));
    connection->start({});
    return connection;
  }
  void run() { loops_->first().io().poll(); }

  ::eigencast::testing::TemporaryFolder folder_;
  Config config_;
  Gate gate_{AccessPolicy::from_config(config_).value()};
  std::unique_ptr<AssetStore> assets_ = AssetStore::open(folder_.file("data"), {}).value();
  Recorder recorder_{{.folder = folder_.file("recordings"),
                      .software = "test",
                      .streams = StreamPatterns::from({}).value(),
                      .include_asset = false},
                     *assets_,
                     {}};
  History history_{{.folder = folder_.file("history"),
                    .software = "test",
                    .streams = StreamPatterns::from(std::vector<std::string>{"**"}).value()},
                   *assets_,
                   {}};
  SoleOwnership ownership_{[]() -> Result<std::uint32_t> { return 1; }};
  asio::thread_pool disk_{1};
  std::unique_ptr<Loops> loops_;
  std::array<int, 2> ends_{-1, -1};
};

// What was received before a pause waits here, past any error of the socket.
TEST_F(ConnectionTest, ReadsNothingOnceClosed) {
  constexpr int kMessages = 1000;
  config_.limits.control_messages_per_s = 100;
  const auto connection = connect();
  std::string flood;
  for (int i = 0; i < kMessages; ++i) flood += masked_text(R"({"op":"unsubscribe","stream":"a"})");
  ASSERT_EQ(::send(ends_[0], flood.data(), flood.size(), MSG_NOSIGNAL), std::ssize(flood));
  while (connection->messages == 0) run();
  ASSERT_LT(connection->messages, kMessages) << "it pauses";
  ::close(ends_[0]);
  // A write fails in the turn in which the pause ends.
  std::this_thread::sleep_for(std::chrono::milliseconds(100));
  connection->send(control::Ping{1, 1});
  while (connection->messages_when_closed < 0) run();
  run();
  EXPECT_EQ(connection->messages, connection->messages_when_closed);
}

/// Pays, and is told nothing.
struct PastViewer final : Rewind::Viewer {
  bool show_past(Rewind&, Stream*) override { return false; }
  void show_present(const Rewind&) override {}
  void refuse_seek(const Rewind&, const Error&) override {}
  TimeUs pay(double) override { return ++paid, 0; }
  std::shared_ptr<void> lifetime() override { return alive; }
  int paid = 0;
  std::shared_ptr<int> alive = std::make_shared<int>();
};

TEST_F(ConnectionTest, SeeksThatNobodyWaitsForAreNotReadAndWhatWasIsPaid) {
  Context& context = begin();
  std::promise<void> reads;
  asio::post(disk_, [go = reads.get_future().share()] { go.wait(); });
  PastViewer viewer;
  std::vector<std::weak_ptr<Rewind>> sought;
  for (int i = 0; i < 200; ++i) {
    const auto rewind = std::make_shared<Rewind>(context, viewer, control::Seek{"lab/horse", 5}, "who", Profile{},
                                                 std::shared_ptr<void>());
    rewind->seek({"lab/horse", 5});
    rewind->stop();
    sought.push_back(rewind);
  }
  const auto left = [&] { return std::ranges::count_if(sought, [](const auto& one) { return !one.expired(); }); };
  EXPECT_EQ(left(), 1) << "the one whose turn it was";
  reads.set_value();
  while (left() > 0) run();
  EXPECT_EQ(viewer.paid, 1) << "though it had stopped";
}

TEST(FairReadsTest, OneAtATimeAndHoldersInTurns) {
  std::deque<FairReads::Work> loading, loop;
  FairReads reads([&](FairReads::Work work) { loading.push_back(std::move(work)); },
                    [&](FairReads::Work work) { loop.push_back(std::move(work)); });
  std::string begun, done;
  const auto read = [&](char name, bool is_wanted = true) {
    return reads.push(std::string(1, name),
                      {[=] { return is_wanted; }, [&, name] { begun += name; }, [&, name] { done += name; }});
  };
  int most = 0;
  while (most < 1000 && read('a')) ++most;
  EXPECT_LT(most, 300) << "it leaves places to others";
  EXPECT_TRUE(read('b', false));
  EXPECT_TRUE(read('c'));
  while (!loading.empty()) {
    ASSERT_EQ(loading.size(), 1U) << "a thread of the disk is left for all else";
    std::exchange(loading, {}).front()();
    ASSERT_EQ(loop.size(), 1U);
    std::exchange(loop, {}).front()();
    EXPECT_EQ(done, begun);
  }
  EXPECT_EQ(done.size(), static_cast<std::size_t>(most) + 1) << "what nobody wants is not read";
  EXPECT_LT(done.find('c'), 3U) << "others do not wait for all of one";
}

}  // namespace
}  // namespace eigencast::broker
