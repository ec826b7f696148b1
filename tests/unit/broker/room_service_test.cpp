// SPDX-License-Identifier: MIT
//
// Rooms of a whole broker.
#include <atomic>
#include <fstream>
#include <set>

#include "broker/access/token_file.h"
#include "broker/connections/subscriber.h"
#include "common/wire/limits.h"
#include "tests/unit/broker/service.h"

namespace eigencast::broker {
namespace {

using namespace testing;
using control::Room;

class RoomServiceTest : public ServiceTest {
 protected:
  /// In room "a", with its answer.
  std::unique_ptr<Client> enter(const std::string& name, const std::string& query = {},
                                const std::string& resume = {}) {
    auto client = std::make_unique<Client>(port_, "/v1/subscribe" + query);
    client->send(control::Enter{"a", name, "#102030", resume});
    answer_ = client->wait_for<Room>();
    return client;
  }
  /// News until `wanted` is among them.
  static Room::Member member_with(Client& client, const std::string& key) {
    for (;;) {
      const auto news = client.wait_for<Room>();
      if (client.failed()) return {};
      for (const Room::Member& member : news.members) {
        for (const auto& value : member.values) {
          if (value.key == key) return member;
        }
      }
    }
  }
  static std::string refusal(Client& client) {
    const auto error = client.wait_for<control::ErrorMessage>();
    EXPECT_EQ(error.room, "a");
    EXPECT_EQ(error.stream, "");
    return error.code;
  }

  Room answer_;
};

TEST_F(RoomServiceTest, TellWhatIsSaidToAllAndToLateJoinersAtOnce) {
  auto ada = enter("Ada");
  const std::uint32_t self = answer_.self;
  EXPECT_TRUE(answer_.speaks);
  EXPECT_EQ(answer_.resume.size(), 64U);
  ada->send(control::Say{"a", {{"pin.1", R"({"note":"here"})"}}, true});
  ada->send(control::Say{"a", {{"pointer", "[1]"}}});
  ada->send(control::Ping{1, 1});
  ada->wait_for<control::Pong>();  // So that all before has been taken.
  auto bob = enter("Bob");
  const auto seen = member_with(*bob, "pin.1");
  EXPECT_EQ(seen.id, self);
  EXPECT_EQ(seen.name, "Ada");
  EXPECT_EQ(seen.values.size(), 2U);
  bob->send(control::Floor{"a", "lead"});
  for (;;) {
    const auto news = ada->wait_for<Room>();
    if (!news.floors.empty()) {
      EXPECT_EQ(news.floors, (std::vector<Room::Holder>{{"lead", answer_.self}}));
      break;
    }
  }
  // Who comes back with its secret has its place again, whether the lost connection still counts or not.
  const std::uint32_t bobs = answer_.self;
  auto again = enter("Bob", {}, answer_.resume);
  EXPECT_EQ(answer_.self, bobs);
  bob->send(control::Say{"a", {{"pointer", "[2]"}}});
  EXPECT_EQ(refusal(*bob), "not-found");
  ada.reset();
  for (;;) {
    const auto left = member_with(*again, "pointer");
    ASSERT_FALSE(again->failed());
    if (left.here) continue;
    EXPECT_EQ(left.id, self);
    EXPECT_EQ(left.values, (std::vector<control::RoomValue>{{"pointer", "null"}}));
    break;
  }
}

TEST_F(RoomServiceTest, HugeNotesAndForeignPinsAreRefusedAndTheConnectionGoesOn) {
  auto ada = enter("Ada");
  const std::uint32_t self = answer_.self;
  ada->send(control::Say{"a", {{"pin.1", '"' + std::string(3000, 'x') + '"'}}, true});
  EXPECT_EQ(refusal(*ada), "too-large");
  auto bob = enter("Bob");
  bob->send(control::Say{"a", {{"pin.1", "null"}}, false, self});
  EXPECT_EQ(refusal(*bob), "refused");
  bob->send(control::Say{"a", {{"ok", "1"}}});
  EXPECT_EQ(member_with(*ada, "ok").id, answer_.self);
  ada->send(control::Say{"b", {{"x", "1"}}});
  EXPECT_EQ(ada->wait_for<control::ErrorMessage>().code, "not-found") << "it is not in that room";
  for (std::size_t i = 1; i < limits::kMaxRooms; ++i) ada->send(control::Enter{"r" + std::to_string(i), "Ada"});
  ada->send(control::Enter{"one-more", "Ada"});
  EXPECT_EQ(ada->wait_for<control::ErrorMessage>().code, "too-large");
}

TEST_F(RoomServiceTest, FloodsAreToldAsTheirLastValue) {
  auto ada = enter("Ada"), bob = enter("Bob");
  constexpr int kSaid = 400;
  for (int i = 0; i <= kSaid; ++i) ada->send(control::Say{"a", {{"pointer", std::to_string(i)}}});
  int told = 0;
  for (std::string last; last != std::to_string(kSaid); ++told) {
    const auto member = member_with(*bob, "pointer");
    ASSERT_FALSE(bob->failed());
    last = member.values.front().json;
  }
  EXPECT_LT(told, kSaid / 2);
}

TEST_F(RoomServiceTest, WhatOthersSayIsPacedAndDelaysNothingElse) {
  const auto speaks = create_static_token("speaks", {}, {"a"}, false, {"a"});
  std::ofstream(folder_ + "/tokens") << speaks->line << "\n";
  stop();
  config_.access.tokens_file = folder_ + "/tokens";
  config_.limits.max_control_bytes = 65'536;
  config_.per_address.work_us_per_s = 5'000;  // Bob's; Ada has a token's.
  std::atomic<int> read_later{0};
  log_ = [&](LogLevel, std::string_view text) { read_later += text.find("work_us_per_s") != text.npos ? 1 : 0; };
  start();
  auto bob = enter("Bob"), ada = enter("Ada", "?access_token=" + speaks->token);
  const std::string note = '"' + std::string(2000, 'x');
  constexpr int kTimes = 5, kNotes = 30;
  const TimeUs begun_us = steady_now_us();
  for (int i = 0; i < kTimes; ++i) {
    control::Say all{"a", {}};
    for (int k = 0; k < kNotes; ++k) all.values.push_back({"k" + std::to_string(k), note + std::to_string(i) + '"'});
    ada->send(all);
    for (std::string last; !last.ends_with(std::to_string(i) + '"') && !bob->failed();)
      last = member_with(*bob, "k9").values.back().json;
    bob->send(control::Ping{1, 1});
    bob->wait_for<control::Pong>();
  }
  EXPECT_EQ(read_later, 0) << "it asked for little";
  constexpr std::int64_t kLeastBytes = (kTimes - 1) * kNotes * 2000;
  EXPECT_GE(steady_now_us() - begun_us,
            (kLeastBytes - Subscriber::kNewsBurst) * 1'000'000 / Subscriber::kNewsBytesPerS);
}

TEST_F(RoomServiceTest, AskForRights) {
  const auto speaks = create_static_token("speaks", {}, {"a"}, false, {"a"}),
             watches = create_static_token("watches", {}, {"a"}, false),
             neither = create_static_token("neither", {}, {"b"}, false, {"a"});
  std::ofstream(folder_ + "/tokens") << speaks->line << "\n" << watches->line << "\n" << neither->line << "\n";
  stop();
  config_.access.tokens_file = folder_ + "/tokens";
  start();
  auto ada = enter("Ada", "?access_token=" + speaks->token);
  EXPECT_TRUE(answer_.speaks);
  auto bob = enter("Bob", "?access_token=" + watches->token);
  EXPECT_FALSE(answer_.speaks);
  bob->send(control::Say{"a", {{"pointer", "[1]"}}});
  EXPECT_EQ(refusal(*bob), "refused");
  bob->send(control::Floor{"a", "lead"});
  EXPECT_EQ(refusal(*bob), "refused");
  ada->send(control::Say{"a", {{"pointer", "[2]"}}});
  EXPECT_EQ(member_with(*bob, "pointer").values.front().json, "[2]");
  Client eve(port_, "/v1/subscribe?access_token=" + neither->token);
  eve.send(control::Enter{"a", "Eve"});
  EXPECT_EQ(refusal(eve), "refused");
  eve.send(control::Say{"a", {{"pointer", "[3]"}}});
  EXPECT_EQ(refusal(eve), "not-found");
}

TEST_F(RoomServiceTest, ViewersOfAGroupAreToldOneMoment) {
  auto publisher = sender("s");
  Client near(port_, "/v1/subscribe"), far(port_, "/v1/subscribe"), alone(port_, "/v1/subscribe");
  for (Client* client : {&near, &far, &alone}) {
    client->send(control::Subscribe{"s", kRaw, client == &alone ? "h" : "g"});
    client->wait_for<control::StreamInfo>();
  }
  near.send(control::Late{"s", 140'000});
  far.send(control::Late{"s", 210'000});
  alone.send(control::Late{"s", 200'000});
  FakeSender motion;
  publisher->send_frame(motion.next(steady_now_us()));
  for (Client* client : {&near, &far}) {
    control::Moment told;
    while (told.lag_us < 209'000 && !client->failed()) told = client->wait_for<control::Moment>();
    EXPECT_LE(told.lag_us, 210'000);
    EXPECT_EQ(told.stream, "s");
  }
  EXPECT_LE(alone.wait_for<control::Moment>().lag_us, 200'000);
}

TEST_F(RoomServiceTest, WhoMayNotSpeakDelaysNobodysMoment) {
  const auto watches = create_static_token("watches", {}, {"**"}, false, {"other"});
  std::ofstream(folder_ + "/tokens") << watches->line << "\n";
  stop();
  config_.access.tokens_file = folder_ + "/tokens";
  start();
  auto publisher = sender("s");
  Client viewer(port_, "/v1/subscribe"), alone(port_, "/v1/subscribe");
  Client evil(port_, "/v1/subscribe?access_token=" + watches->token);
  for (Client* client : {&viewer, &alone, &evil}) {
    client->send(control::Subscribe{"s", kRaw, client == &alone ? "alone" : "wall"});
    client->wait_for<control::StreamInfo>();
  }
  evil.send(control::Late{"s", steady_now_us()});
  evil.send(control::Ping{1, 1});
  evil.wait_for<control::Pong>();
  FakeSender motion;
  publisher->send_frame(motion.next(steady_now_us()));
  const TimeUs undelayed_us = alone.wait_for<control::Moment>().lag_us;
  EXPECT_EQ(viewer.wait_for<control::Moment>().lag_us, undelayed_us);
  EXPECT_EQ(evil.wait_for<control::Moment>().lag_us, undelayed_us) << "it follows";
}

TEST_F(RoomServiceTest, CanBeOff) {
  stop();
  config_.rooms.enabled = false;
  start();
  Client ada(port_, "/v1/subscribe");
  ada.send(control::Enter{"a", "Ada"});
  EXPECT_EQ(refusal(ada), "unsupported");
}

TEST_F(RoomServiceTest, AreTheSameInAllLoops) {
  stop();
  config_.server.threads = 3;
  start();
  std::vector<std::unique_ptr<Client>> all;
  std::vector<std::uint32_t> ids;
  for (int i = 0; i < 6; ++i) {
    all.push_back(enter("P" + std::to_string(i)));
    ids.push_back(answer_.self);
  }
  all.front()->send(control::Say{"a", {{"pointer", "[7]"}}});
  for (const auto& client : all) EXPECT_EQ(member_with(*client, "pointer").id, ids.front());
}

}  // namespace
}  // namespace eigencast::broker
