// SPDX-License-Identifier: MIT
#include "sdk/room.h"

#include <gtest/gtest.h>

#include <thread>

#include "common/wire/limits.h"
#include "tests/support/loopback_broker.h"

namespace eigencast {
namespace {

using testing::LoopbackBroker;

std::unique_ptr<RoomClient> enter(const LoopbackBroker& broker, const std::string& name) {
  auto room = RoomClient::enter(broker.url("live/ball"), {}, {"live/ball", name, "#102030"});
  EXPECT_TRUE(room) << room.error().message;
  return std::move(*room);
}

/// Waits until it is so; the test's time limit ends it.
template <typename Check>
RoomState state_when(const RoomClient& room, Check check) {
  RoomState state;
  for (room.read(state); !check(state); room.read(state)) std::this_thread::sleep_for(std::chrono::milliseconds(5));
  return state;
}

const RoomState::Member* member_named(const RoomState& state, const std::string& name) {
  for (const auto& [id, member] : state.members) {
    if (member.name == name) return &member;
  }
  return nullptr;
}

bool says(const RoomState& state, const std::string& name, const std::string& key, const std::string& json) {
  const RoomState::Member* member = member_named(state, name);
  const auto value = member == nullptr ? decltype(member->values.end()){} : member->values.find(key);
  return member != nullptr && value != member->values.end() && value->second == json;
}

TEST(RoomClient, TellsTheOthersWhatIsSaidLast) {
  LoopbackBroker broker;
  const auto ada = enter(broker, "Ada"), bob = enter(broker, "Bob");
  for (int i = 0; i <= 100; ++i) ada->say("pointer", "[" + std::to_string(i) + "]");
  state_when(*bob, [](const RoomState& s) { return says(s, "Ada", "pointer", "[100]"); });
  ada->say("pointer", "null");
  state_when(*bob, [](const RoomState& s) { return member_named(s, "Ada")->values.empty(); });
  bob->take("lead");
  const RoomState seen = state_when(*ada, [](const RoomState& s) { return s.holder_of("lead") != nullptr; });
  EXPECT_EQ(seen.holder_of("lead")->name, "Bob");
  bob->take("lead", false);
  state_when(*ada, [](const RoomState& s) { return s.holder_of("lead") == nullptr; });
}

TEST(RoomClient, KeepsNoMoreThanARoomMayHold) {
  RoomState state;
  for (std::uint32_t id = 1; id <= 3000; ++id) {
    control::Room news;
    news.room = "a";
    news.members = {{id % 1500 + 1, "P", "#102030", true, {{"k" + std::to_string(id), "1"}}},
                    {1, "P", "#102030", true, {{"k" + std::to_string(id), "1"}}}};
    news.floors = {{"f" + std::to_string(id), 1}, {"g" + std::to_string(id), 0}};
    state.take(news);
  }
  EXPECT_EQ(state.members.size(), limits::kMaxRoomMembers);
  EXPECT_EQ(state.members.at(1).values.size(), limits::kMaxRoomKeys);
  EXPECT_EQ(state.floors.size(), limits::kMaxRoomFloors);
  control::Room free;
  free.floors = {{"f1", 0}};
  state.take(free);
  EXPECT_FALSE(state.floors.contains("f1"));
  EXPECT_TRUE(state.members.contains(1));
}

TEST(RoomClient, LeavesAndOthersRemoveWhatItKept) {
  LoopbackBroker broker;
  auto ada = enter(broker, "Ada");
  const auto bob = enter(broker, "Bob");
  ada->say("pin.1", "[1]", true);
  ada->say("pointer", "[2]");
  state_when(*bob,
             [](const RoomState& s) { return says(s, "Ada", "pointer", "[2]") && says(s, "Ada", "pin.1", "[1]"); });
  ada.reset();
  const RoomState left = state_when(*bob, [](const RoomState& s) { return !member_named(s, "Ada")->here; });
  EXPECT_TRUE(says(left, "Ada", "pin.1", "[1]"));
  EXPECT_EQ(member_named(left, "Ada")->values.size(), 1U);
  for (const auto& [id, member] : left.members) {
    if (member.name == "Ada") bob->remove(id, "pin.1");
  }
  state_when(*bob, [](const RoomState& s) { return member_named(s, "Ada") == nullptr; });
}

TEST(RoomClient, ComesBackWithAllThatItSaid) {
  LoopbackBroker broker;
  const auto ada = enter(broker, "Ada"), bob = enter(broker, "Bob");
  ada->say("pin.1", "[1]", true);
  ada->say("camera", "[2]");
  state_when(*bob, [](const RoomState& s) { return says(s, "Ada", "camera", "[2]"); });
  broker.stop();
  state_when(*bob, [](const RoomState& s) { return !s.open && !s.trouble.empty(); });
  broker.start();
  const RoomState again = state_when(*bob, [](const RoomState& s) {
    return s.open && says(s, "Ada", "camera", "[2]") && says(s, "Ada", "pin.1", "[1]");
  });
  EXPECT_EQ(again.members.size(), 2U);
}

TEST(RoomClient, NamesAreCheckedBeforeAnythingIsSent) {
  const auto room = RoomClient::enter("ws://127.0.0.1:9/a", {}, {"a//b", "Ada"});
  ASSERT_FALSE(room);
  EXPECT_EQ(room.error().code, ErrorCode::kInvalidArgument);
  EXPECT_FALSE(RoomClient::enter("ws://127.0.0.1:9/a", {}, {"a", ""}));
}

}  // namespace
}  // namespace eigencast
