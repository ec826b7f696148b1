// SPDX-License-Identifier: MIT
#include "broker/connections/connection.h"

#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <deque>
#include <functional>
#include <future>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "broker/connections/rewind.h"
#include "broker/loops/loops.h"
#include "broker/relay/fair_reads.h"
#include "broker/relay/ownership.h"
#include "broker/sockets/disk_threads.h"
#include "broker/storage/asset_store.h"
#include "broker/storage/history.h"
#include "broker/storage/recorder.h"
#include "broker/websocket/protocol.h"
#include "tests/support/process.h"

namespace eigencast::broker {
namespace {

/// Counts messages, and beats, which take `beat_us`.
class Counting final : public Connection {
 public:
  Counting(Context& context, Transport transport, GrantPtr grant)
      : Connection(context, std::move(transport), std::move(grant), {2048, 2048}) {}
  using Connection::send;

  int messages = 0, messages_when_closed = -1, beats = 0;
  bool views = false;
  double beat_us = 0;

 private:
  void on_open() override {}
  void on_message(const ControlMessage&) override { ++messages; }
  void on_beat() override {
    ++beats;
    charge(beat_us);
  }
  bool takes_turns() const override { return views; }
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
  ~ConnectionTest() override {
    for (const int peer : peers_) ::close(peer);
  }
  Context& begin() {
    if (!loops_) {
      loops_ = std::make_unique<Loops>(
          config_,
          SharedContext{
              disk_, disk_, disk_, gate_, *assets_, recorder_, history_, ownership_, nullptr, {}, "test", "session"},
          std::vector<StreamTap*>{});
      loops_->first().begin();
    }
    return loops_->first().context();
  }
  std::shared_ptr<Counting> connect(const std::string& address = "127.0.0.1") {
    EXPECT_EQ(::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends_.data()), 0);
    peers_.push_back(ends_[0]);
    Context& context = begin();
    Socket socket(context.loop.get_executor());
    socket.assign(Tcp::v4(), ends_[1]);
    auto grant = gate_.accept(IpAddress::from_text(address).value(), 0, steady_now_us());
    auto connection =
        std::make_shared<Counting>(context, Transport(std::move(socket)), std::get<GrantPtr>(std::move(grant)));
    connection->start({});
    return connection;
  }
  void run() { loops_->first().io().poll(); }
  std::shared_ptr<Counting> connect_viewer(int address) {
    auto viewer = connect("198.51.100." + std::to_string(address));
    viewer->views = true;
    return viewer;
  }
  /// Runs the loop until `done_us` is `all_us`; by how much twice what was done between two turns of a stream was more
  /// than the time between them, at most.
  double most_over_half(double all_us, const std::function<double()>& done_us) {
    double most_us = 0, before_us = done_us();
    TimeUs since_us = steady_now_us();
    std::function<void()> stream = [&] {
      const double work_us = done_us() - std::exchange(before_us, done_us());
      const TimeUs now_us = steady_now_us();
      most_us = std::max(most_us, 2 * work_us - static_cast<double>(now_us - std::exchange(since_us, now_us)));
      if (before_us < all_us) asio::post(loops_->first().io(), stream);
    };
    asio::post(loops_->first().io(), stream);
    while (before_us < all_us) loops_->first().io().run_one();
    return most_us;
  }

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
  DiskThreads disk_{1};
  std::unique_ptr<Loops> loops_;
  std::array<int, 2> ends_{-1, -1};  ///< Of the last connection.
  std::vector<int> peers_;
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
  ::shutdown(ends_[0], SHUT_RDWR);
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

TEST(DiskThreadsTest, OneWhoAsksALotDoesNotKeepOthersWaiting) {
  std::promise<void> begins;
  std::string order;
  {
    DiskThreads threads(1);
    threads.post("a", [go = begins.get_future().share()] { go.wait(); });
    for (int i = 0; i < 100; ++i) threads.post("a", [&order] { order += 'a'; });
    threads.post("b", [&order] { order += 'b'; });
    begins.set_value();
    threads.join();
  }
  EXPECT_EQ(order.size(), 101U);
  EXPECT_LE(order.find('b'), 1U);
}

TEST_F(ConnectionTest, SeeksThatNobodyWaitsForAreNotReadAndWhatWasIsPaid) {
  Context& context = begin();
  std::promise<void> reads;
  disk_.post({}, [go = reads.get_future().share()] { go.wait(); });
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

// Each address has a budget of its own: what all ask for at one moment delays a stream all the same.
TEST_F(ConnectionTest, WhatCrowdsAskForLeavesStreamsTheirTurnsAndOthersTheirs) {
  constexpr int kViewers = 160, kEach = 50, kAddresses = 16;
  constexpr double kMessageUs = 4, kTurnUs = 100, kAtOnceUs = 2'500;
  std::string flood;
  for (int i = 0; i < kEach; ++i) flood += masked_text(R"({"op":"unsubscribe","stream":"a"})");
  std::vector<std::shared_ptr<Counting>> viewers;
  for (int i = 0; i < kViewers; ++i) {
    viewers.push_back(connect_viewer(i % kAddresses));
    ASSERT_EQ(::send(ends_[0], flood.data(), flood.size(), MSG_NOSIGNAL), std::ssize(flood));
  }
  const auto other = connect_viewer(kAddresses);
  const auto done_us = [&] {
    double sum_us = 0;
    for (const auto& viewer : viewers) sum_us += kMessageUs * viewer->messages;
    return sum_us;
  };
  constexpr double kAllUs = kViewers * kEach * kMessageUs, kMostUs = 2 * (kAtOnceUs + kTurnUs + kMessageUs);
  EXPECT_LE(most_over_half(kAllUs / 4, done_us), kMostUs);
  const std::string one = masked_text(R"({"op":"trace_request","stream":"a","every":1})");
  ASSERT_EQ(::send(ends_[0], one.data(), one.size(), MSG_NOSIGNAL), std::ssize(one));
  const double asked_at_us = done_us();
  double heard_at_us = 0;
  EXPECT_LE(most_over_half(kAllUs,
                           [&] {
                             if (other->messages > 0 && heard_at_us == 0) heard_at_us = done_us();
                             return done_us();
                           }),
            kMostUs);
  EXPECT_LE(heard_at_us - asked_at_us, (kAddresses + 4) * (kTurnUs + kMessageUs)) << "it waits for a turn of each";
}

TEST_F(ConnectionTest, FirstMessagesOfManyConnectionsAreNotCheap) {
  constexpr int kTurns = 40, kEach = 20, kOthers = 60;  // Of 4 us; those of the other take three turns.
  begin().viewers.pay(100'000, steady_now_us());
  const auto ask = [&](int address, int messages) {
    auto viewer = connect_viewer(address);
    std::string flood;
    for (int i = 0; i < messages; ++i) flood += masked_text(R"({"op":"unsubscribe","stream":"a"})");
    EXPECT_EQ(::send(ends_[0], flood.data(), flood.size(), MSG_NOSIGNAL), std::ssize(flood));
    return viewer;
  };
  const auto other = ask(1, kOthers);
  std::vector<std::shared_ptr<Counting>> crowd;
  for (int i = 0; i < kTurns; ++i) crowd.push_back(ask(2, kEach));
  while (other->messages < kOthers) loops_->first().io().run_one();
  int before = 0;
  for (const auto& viewer : crowd) before += viewer->messages;
  EXPECT_LE(before, kTurns * kEach * 3 / 4) << "it does not wait for all of them";
}

TEST_F(ConnectionTest, WhatCrowdsAreToldLeavesStreamsTheirTurns) {
  constexpr int kViewers = 160;
  constexpr double kBeatUs = 500, kAtOnceUs = 2'500;
  std::vector<std::shared_ptr<Counting>> viewers;
  for (int i = 0; i < kViewers; ++i) {
    viewers.push_back(connect_viewer(i % 16));
    viewers.back()->beat_us = kBeatUs;
  }
  Context& context = loops_->first().context();
  for (const auto& viewer : viewers) context.on_beat.emplace(viewer->id(), viewer.get());
  context.arm_beat();
  const double most_us = most_over_half(kViewers * kBeatUs, [&] {
    double sum_us = 0;
    for (const auto& viewer : viewers) sum_us += kBeatUs * viewer->beats;
    return sum_us;
  });
  EXPECT_LE(most_us, 2 * (kAtOnceUs + kBeatUs));
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
