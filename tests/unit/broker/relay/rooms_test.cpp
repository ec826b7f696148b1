// SPDX-License-Identifier: MIT
#include "broker/relay/rooms.h"

#include <gtest/gtest.h>

#include <map>
#include <set>
#include <variant>

#include "common/wire/limits.h"

namespace eigencast::broker {
namespace {

using control::RoomValue;

/// What a member knows of a room, by the rules of docs/protocol.md.
struct Known {
  struct Member {
    std::string name;
    bool here = true;
    std::map<std::string, std::string> values;
    bool operator==(const Member&) const = default;
  };
  std::map<std::uint32_t, Member> members;
  std::map<std::string, std::uint32_t> floors;
  int messages = 0;
  std::size_t bytes = 0;

  void take(const std::vector<Outbox::Text>& texts) {
    for (const Outbox::Text& framed : texts) {
      const auto message = control_from_text(std::string_view(*framed).substr(framed->find('{')));
      ASSERT_TRUE(message) << message.error().message;
      take(std::get<control::Room>(*message));
      ++messages;
      bytes += framed->size();
    }
  }
  void take(const control::Room& news) {
    if (news.whole) members.clear(), floors.clear();
    for (const std::uint32_t id : news.gone) members.erase(id);
    for (const auto& change : news.members) {
      Member& member = members[change.id];
      if (!change.name.empty()) member.name = change.name;
      member.here = change.here;
      for (const RoomValue& value : change.values) {
        value.json == "null" ? void(member.values.erase(value.key)) : void(member.values[value.key] = value.json);
      }
    }
    for (const auto& held : news.floors) floors[held.floor] = held.member;
  }
  bool operator==(const Known& other) const {
    const auto held = [](auto all) {
      std::erase_if(all, [](const auto& floor) { return floor.second == 0; });
      return all;
    };
    return members == other.members && held(floors) == held(other.floors);
  }
};

class RoomsTest : public ::testing::Test {
 protected:
  struct Person {
    Rooms::Seat seat;
    Known known;
  };
  Result<Rooms::Seat> try_to_enter(const std::string& name, const std::string& holder = {},
                                   const std::string& proof = "proof", const std::string& former = {}) {
    return rooms_.enter({"a", name}, {holder, proof, former}, limits_);
  }
  Person enter(const std::string& name, const std::string& proof = "proof", const std::string& former = {}) {
    auto seat = try_to_enter(name, {}, proof, former);
    EXPECT_TRUE(seat) << seat.error().message;
    return {*seat, {}};
  }
  Result<void> say(const Person& who, std::vector<RoomValue> values, bool keep = false, std::uint32_t member = 0) {
    return rooms_.say({"a", std::move(values), keep, member}, who.seat, limits_);
  }
  ErrorCode code_of(const Result<void>& result) { return result ? ErrorCode::kInternal : result.error().code; }
  const Known& look(Person& who) {
    who.known.take(rooms_.news("a", who.seat));
    return who.known;
  }

  Rooms rooms_;
  Rooms::Limits limits_;
};

TEST_F(RoomsTest, LateJoinersGetTheStateAtOnce) {
  Person ada = enter("Ada");
  ASSERT_TRUE(say(ada, {{"camera", "[1,2]"}, {"pin.1", R"({"note":"here"})"}}));
  ASSERT_TRUE(rooms_.take({"a", "lead"}, ada.seat));
  Person bob = enter("Bob");
  const Known& seen = look(bob);
  ASSERT_EQ(seen.members.size(), 2U);
  EXPECT_EQ(seen.members.at(ada.seat.member).name, "Ada");
  EXPECT_EQ(seen.members.at(ada.seat.member).values.at("pin.1"), R"({"note":"here"})");
  EXPECT_EQ(seen.floors.at("lead"), ada.seat.member);
  EXPECT_EQ(look(ada), seen);
  EXPECT_TRUE(rooms_.news("a", bob.seat).empty()) << "nothing is new";
}

TEST_F(RoomsTest, OnlyTheLastValuesAreTold) {
  Person ada = enter("Ada"), bob = enter("Bob");
  look(bob);
  const Known before = bob.known;
  for (int i = 0; i < 1000; ++i) ASSERT_TRUE(say(ada, {{"pointer", "[" + std::to_string(i) + "]"}}));
  EXPECT_EQ(look(bob).members.at(ada.seat.member).values.at("pointer"), "[999]");
  EXPECT_EQ(bob.known.messages, before.messages + 1);
  EXPECT_LT(bob.known.bytes - before.bytes, 200U);
  ASSERT_TRUE(say(ada, {{"pointer", "[999]"}}));
  EXPECT_TRUE(rooms_.news("a", bob.seat).empty()) << "what is said again is not news";
}

TEST_F(RoomsTest, AllThatKnowTheSameShareTheBytes) {
  Person ada = enter("Ada"), bob = enter("Bob");
  (void)rooms_.news("a", ada.seat);
  (void)rooms_.news("a", bob.seat);
  ASSERT_TRUE(say(ada, {{"pointer", "[1]"}}));
  const auto one = rooms_.news("a", ada.seat), other = rooms_.news("a", bob.seat);
  ASSERT_EQ(one.size(), 1U);
  EXPECT_EQ(one.front().get(), other.front().get());
}

TEST_F(RoomsTest, ALeaversPointerGoesAndItsPinsStay) {
  Person ada = enter("Ada"), bob = enter("Bob");
  ASSERT_TRUE(say(ada, {{"pointer", "[1]"}}));
  ASSERT_TRUE(say(ada, {{"pin.1", "[2]"}}, true));
  ASSERT_TRUE(rooms_.take({"a", "lead"}, ada.seat));
  look(bob);
  rooms_.leave("a", ada.seat);
  const Known::Member left = look(bob).members.at(ada.seat.member);
  EXPECT_FALSE(left.here);
  EXPECT_EQ(left.values, (std::map<std::string, std::string>{{"pin.1", "[2]"}}));
  EXPECT_EQ(bob.known.floors.at("lead"), 0U);
  EXPECT_EQ(code_of(say(ada, {{"pin.1", "[3]"}})), ErrorCode::kNotFound);
  EXPECT_EQ(code_of(say(bob, {{"pin.1", "[3]"}}, false, ada.seat.member)), ErrorCode::kRefused);
  ASSERT_TRUE(say(bob, {{"pin.1", "null"}}, false, ada.seat.member));
  EXPECT_FALSE(look(bob).members.contains(ada.seat.member)) << "nothing of it is left";
  rooms_.leave("a", bob.seat);
  EXPECT_EQ(rooms_.size(), 0U);
  EXPECT_EQ(rooms_.bytes(), 0);
}

TEST_F(RoomsTest, MembersChangeOnlyWhatIsTheirOwn) {
  Person ada = enter("Ada"), bob = enter("Bob");
  ASSERT_TRUE(say(ada, {{"pin.1", "[1]"}}, true));
  EXPECT_EQ(code_of(say(bob, {{"pin.1", "[2]"}}, true, ada.seat.member)), ErrorCode::kRefused);
  EXPECT_EQ(code_of(say(bob, {{"pin.1", "null"}}, true, ada.seat.member)), ErrorCode::kRefused);
  EXPECT_EQ(code_of(say(bob, {{"pin.1", "null"}}, true, 99)), ErrorCode::kNotFound);
  EXPECT_EQ(look(bob).members.at(ada.seat.member).values.at("pin.1"), "[1]");
  const Rooms::Seat made_up{ada.seat.member, bob.seat.session};
  EXPECT_EQ(code_of(rooms_.say({"a", {{"x", "1"}}}, made_up, limits_)), ErrorCode::kNotFound);
  EXPECT_EQ(code_of(rooms_.say({"b", {{"x", "1"}}}, ada.seat, limits_)), ErrorCode::kNotFound);
}

TEST_F(RoomsTest, TheLastWhoTakesAFloorHasIt) {
  Person ada = enter("Ada"), bob = enter("Bob");
  ASSERT_TRUE(rooms_.take({"a", "lead"}, ada.seat));
  ASSERT_TRUE(rooms_.take({"a", "lead"}, bob.seat));
  EXPECT_EQ(look(ada).floors.at("lead"), bob.seat.member);
  EXPECT_EQ(code_of(rooms_.take({"a", "lead", false}, ada.seat)), ErrorCode::kRefused);
  ASSERT_TRUE(rooms_.take({"a", "lead", false}, bob.seat));
  EXPECT_EQ(look(ada).floors.at("lead"), 0U);
  for (std::size_t i = 0; i < limits::kMaxRoomFloors; ++i)
    ASSERT_TRUE(rooms_.take({"a", "f" + std::to_string(i)}, ada.seat));
  EXPECT_EQ(code_of(rooms_.take({"a", "more"}, ada.seat)), ErrorCode::kTooLarge);
}

TEST_F(RoomsTest, ALostConnectionsPlaceIsTakenOverWithItsSecretOnly) {
  Person ada = enter("Ada", "first"), bob = enter("Bob", "other");
  ASSERT_TRUE(say(ada, {{"pin.1", "[1]"}}, true));
  look(bob);
  EXPECT_NE(try_to_enter("Eve", {}, "new", "guessed")->member, ada.seat.member);
  EXPECT_NE(try_to_enter("Eve", "address x", "new", "first")->member, ada.seat.member) << "another holder's";
  Person again = enter("Ada L.", "second", "first");
  EXPECT_EQ(again.seat.member, ada.seat.member);
  EXPECT_EQ(code_of(say(ada, {{"pin.1", "[2]"}})), ErrorCode::kNotFound) << "its place is another connection's";
  EXPECT_TRUE(rooms_.news("a", ada.seat).empty());
  rooms_.leave("a", ada.seat);
  EXPECT_TRUE(look(bob).members.at(ada.seat.member).here);
  EXPECT_EQ(bob.known.members.at(ada.seat.member).name, "Ada L.");
  EXPECT_EQ(look(again).members.at(ada.seat.member).values.at("pin.1"), "[1]");
}

TEST_F(RoomsTest, HugeNotesAndManyKeysAreRefusedWhole) {
  Person ada = enter("Ada");
  const std::string huge = '"' + std::string(limits::kMaxRoomValueBytes - 1, 'x') + '"';
  EXPECT_EQ(code_of(say(ada, {{"a", "1"}, {"b", huge}})), ErrorCode::kTooLarge);
  EXPECT_TRUE(look(ada).members.at(ada.seat.member).values.empty());
  for (std::size_t i = 0; i < limits::kMaxRoomKeys; ++i) ASSERT_TRUE(say(ada, {{"k" + std::to_string(i), "1"}}));
  EXPECT_EQ(code_of(say(ada, {{"one-more", "1"}})), ErrorCode::kTooLarge);
  EXPECT_TRUE(say(ada, {{"k0", "null"}, {"one-more", "1"}}));
}

TEST_F(RoomsTest, BytesOfARoomAreLimitedAndChargedToHolders) {
  limits_.max_room_bytes = 65'536;
  const auto bob = try_to_enter("Bob", "bob");
  const std::string note = '"' + std::string(2000, 'x') + '"';
  const auto notes_of = [&](const Rooms::Seat& seat) {
    int count = 0;
    while (rooms_.say({"a", {{"k" + std::to_string(count), note}}, true}, seat, limits_)) ++count;
    return count;
  };
  for (int i = 0; i < 4; ++i) {
    const auto ada = try_to_enter("Ada", "ada");
    EXPECT_EQ(notes_of(*ada), 3) << "of 4,136 bytes each, a quarter of what is free";
    rooms_.leave("a", *ada);
  }
  EXPECT_LE(rooms_.bytes(), limits_.max_room_bytes);
  // What those kept who have left makes room, the oldest first.
  EXPECT_EQ(notes_of(*bob), 3);
  Known known;
  known.take(rooms_.news("a", *bob));
  EXPECT_EQ(known.members.size(), 4U);
  EXPECT_FALSE(known.members.contains(bob->member + 1));
  // Of all rooms one holder has a quarter of what is free.
  limits_ = {.max_bytes = 80'000};
  const auto other = rooms_.enter({"b", "Bob"}, {"bob", "proof", {}}, limits_);
  EXPECT_EQ(code_of(other ? Result<void>() : other.error()), ErrorCode::kTooLarge);
  EXPECT_TRUE(rooms_.enter({"b", "Cleo"}, {"cleo", "proof", {}}, limits_));
}

TEST_F(RoomsTest, OneHolderLeavesOthersRoomToSpeakAndToEnter) {
  const auto ada = try_to_enter("Ada", "ada"), bob = try_to_enter("Bob", "bob");
  const std::string note = '"' + std::string(2000, 'x') + '"';
  std::size_t said = 0;
  while (rooms_.say({"a", {{"k" + std::to_string(said), note}}, true}, *ada, limits_)) ++said;
  EXPECT_GT(said, 8U);
  EXPECT_LT(said, limits::kMaxRoomKeys) << "it had all of the room";
  EXPECT_TRUE(try_to_enter("Cleo", "cleo"));
  for (int i = 0; i < 8; ++i)
    EXPECT_TRUE(rooms_.say({"a", {{"k" + std::to_string(i), note}}, true}, *bob, limits_)) << i;
}

TEST_F(RoomsTest, WhoComesBackInNumbersLeavesOthersRoomToo) {
  const auto bob = try_to_enter("Bob", "bob");
  const std::string note = '"' + std::string(2000, 'x') + '"';
  const auto say_all = [&](const Rooms::Seat& seat) {
    for (int k = 0; rooms_.say({"a", {{"k" + std::to_string(k), note}}, true}, seat, limits_);) ++k;
  };
  for (const char* name : {"1", "2", "3", "4", "5"}) {
    const auto ada = try_to_enter(name, "ada", name);
    say_all(*ada);
    rooms_.leave("a", *ada);
  }
  for (const char* name : {"1", "2", "3", "4", "5"}) EXPECT_TRUE(try_to_enter(name, "ada", name, name));
  EXPECT_TRUE(rooms_.say({"a", {{"k", note}}}, *bob, limits_));
  EXPECT_EQ(try_to_enter("1", "ada", "1", "1")->member, bob->member + 1) << "the first had its share";
}

TEST_F(RoomsTest, WhatIsRefusedMakesNobodysNotesGo) {
  limits_.max_room_bytes = 32'768;
  const auto left = try_to_enter("Left", "left"), bob = try_to_enter("Bob", "bob"), ada = try_to_enter("Ada", "ada");
  const std::string note = '"' + std::string(2000, 'x') + '"';
  ASSERT_TRUE(rooms_.say({"a", {{"pin.1", note}}, true}, *left, limits_));
  rooms_.leave("a", *left);
  std::vector<RoomValue> notes;
  for (int i = 0; i < 8; ++i) notes.push_back({"k" + std::to_string(i), note});
  EXPECT_EQ(code_of(rooms_.say({"a", notes, true}, *ada, limits_)), ErrorCode::kTooLarge);
  Known known;
  known.take(rooms_.news("a", *bob));
  EXPECT_TRUE(known.members.contains(left->member));
}

TEST_F(RoomsTest, AllWhoGetEverythingShareTheBytes) {
  Person ada = enter("Ada"), bob = enter("Bob");
  ASSERT_TRUE(say(ada, {{"pointer", "[1]"}}));
  Person cleo = enter("Cleo");
  const auto one = rooms_.news("a", bob.seat), other = rooms_.news("a", cleo.seat);
  ASSERT_EQ(one.size(), 1U);
  EXPECT_EQ(one.front().get(), other.front().get());
}

TEST_F(RoomsTest, WhatComesAndGoesUnheardMakesNobodyGetEverything) {
  Person ada = enter("Ada"), bob = enter("Bob"), evil = enter("Evil");
  const std::string note = '"' + std::string(2000, 'x') + '"';
  for (int i = 0; i < 20; ++i) ASSERT_TRUE(say(ada, {{"pin." + std::to_string(i), note}}, true));
  look(bob);
  for (int beat = 0; beat < 3; ++beat) {
    const std::size_t before = bob.known.bytes;
    std::vector<RoomValue> all;
    for (int i = 0; i < 30; ++i) {
      for (std::size_t k = 0; i % 2 == 0 && k < limits::kMaxRoomKeys; ++k)
        all.push_back({"k" + std::to_string(i) + "." + std::to_string(k), "1"});
      ASSERT_TRUE(say(evil, all));
      look(evil);
      for (RoomValue& value : all) value.json = "null";
      if (i % 2 == 1) all.clear();
    }
    for (int i = 0; i < 600; ++i) {
      const auto guest = try_to_enter("Guest", "guest");
      ASSERT_TRUE(guest);
      rooms_.leave("a", *guest);
    }
    look(bob);
    EXPECT_LT(bob.known.bytes - before, 10'000U) << "Ada's notes are told once";
  }
  Person fresh = enter("Fresh");
  EXPECT_EQ(look(bob), look(fresh));
}

TEST_F(RoomsTest, WhatComesAndGoesUnheardIsNoNews) {
  Person ada = enter("Ada"), bob = enter("Bob");
  look(bob);
  ASSERT_TRUE(say(ada, {{"k", "1"}}));
  ASSERT_TRUE(say(ada, {{"k", "null"}}));
  rooms_.leave("a", enter("Guest").seat);
  EXPECT_TRUE(rooms_.news("a", bob.seat).empty());
}

TEST_F(RoomsTest, NewsOfManyKeysOfOneMemberCanBeRead) {
  Person ada = enter("Ada"), bob = enter("Bob");
  const auto say_keys = [&](const std::string& prefix, const std::string& json) {
    std::vector<RoomValue> all;
    for (std::size_t i = 0; i < limits::kMaxRoomKeys; ++i) all.push_back({prefix + std::to_string(i), json});
    ASSERT_TRUE(say(ada, all));
  };
  say_keys("a", "1");
  look(bob);
  say_keys("a", "null");
  say_keys("b", "2");
  const auto& values = look(bob).members.at(ada.seat.member).values;
  EXPECT_EQ(values.size(), limits::kMaxRoomKeys);
  EXPECT_EQ(values.at("b0"), "2");
}

TEST_F(RoomsTest, WhoMissedMoreThanIsKeptGetsEverything) {
  limits_.max_room_bytes = 1 << 20;
  std::vector<Person> speakers;
  for (int i = 0; i < 20; ++i) speakers.push_back(enter("P" + std::to_string(i), "p" + std::to_string(i)));
  Person slow = enter("Slow", "slow"), other = enter("Other", "other");
  const auto say_all = [&](const std::string& json) {
    for (const Person& speaker : speakers) {
      std::vector<RoomValue> all;
      for (std::size_t i = 0; i < limits::kMaxRoomKeys; ++i) all.push_back({"k" + std::to_string(i), json});
      ASSERT_TRUE(say(speaker, all));
    }
  };
  say_all("1");
  look(slow);
  look(other);
  say_all("null");
  Person fresh = enter("Fresh", "fresh");
  look(fresh);
  EXPECT_EQ(look(slow), fresh.known);
  EXPECT_EQ(look(other), fresh.known);
}

TEST_F(RoomsTest, WhatIsToBeToldIsChargedUntilAllKnowIt) {
  Person ada = enter("Ada"), bob = enter("Bob");
  std::vector<RoomValue> all;
  for (int i = 0; i < 10; ++i) all.push_back({"k" + std::to_string(i), "1"});
  ASSERT_TRUE(say(ada, all));
  look(bob);
  for (RoomValue& value : all) value.json = "null";
  ASSERT_TRUE(say(ada, all));
  const std::int64_t members = 2 * Rooms::kMemberBytes;
  EXPECT_EQ(rooms_.bytes(), members + 10 * Rooms::kValueBytes);
  look(bob);
  ASSERT_TRUE(say(bob, {{"none", "null"}}));
  EXPECT_EQ(rooms_.bytes(), members);
}

TEST_F(RoomsTest, FloorsThatNobodyHasMakeRoomAndNobodyMakesAll) {
  const auto ada = try_to_enter("Ada", "ada"), bob = try_to_enter("Bob", "bob");
  std::size_t made = 0;
  while (rooms_.take({"a", "f" + std::to_string(made)}, *ada)) ++made;
  EXPECT_EQ(made, limits::kMaxRoomFloors / 2);
  EXPECT_TRUE(rooms_.take({"a", "lead"}, *bob));
  EXPECT_EQ(rooms_.bytes(), 2 * Rooms::kMemberBytes + 5 * Rooms::kValueBytes);
  (void)rooms_.news("a", *bob);
  for (std::size_t i = 0; i < made; ++i) ASSERT_TRUE(rooms_.take({"a", "f" + std::to_string(i), false}, *ada));
  EXPECT_EQ(code_of(rooms_.take({"a", "more"}, *ada)), ErrorCode::kTooLarge) << "Bob does not know yet";
  Known known;
  known.take(rooms_.news("a", *bob));
  EXPECT_EQ(known.floors.at("f0"), 0U);
  EXPECT_TRUE(rooms_.take({"a", "more"}, *ada));
}

TEST_F(RoomsTest, NumbersOfMembersThatWrapAroundAreNobodyElses) {
  Rooms rooms(~std::uint32_t{0} - 1);
  const auto enter_one = [&] { return rooms.enter({"a", "P"}, {{}, "proof", {}}, limits_)->member; };
  EXPECT_EQ(enter_one(), ~std::uint32_t{0});
  EXPECT_EQ(enter_one(), 1U) << "0 is nobody";
}

TEST_F(RoomsTest, AFullRoomOfPeopleCanSpeak) {
  for (std::int64_t i = 0; i < limits_.max_members; ++i) {
    const std::string name = std::to_string(i);
    const auto seat = try_to_enter(name, name, name);
    ASSERT_TRUE(seat) << name;
    EXPECT_TRUE(rooms_.say({"a", {{"pointer", '"' + std::string(150, 'x') + '"'}}}, *seat, limits_)) << name;
  }
}

TEST_F(RoomsTest, MembersAreLimitedAndHoldersHaveShares) {
  limits_.max_members = 20;
  int own = 0, others = 0;
  while (try_to_enter("Ada", "ada")) ++own;
  EXPECT_EQ(own, 4) << "a quarter of what is free";
  while (try_to_enter("Bob", "holder " + std::to_string(others))) ++others;
  EXPECT_EQ(own + others, 20);
  EXPECT_EQ(rooms_.members(), 20U);
}

TEST_F(RoomsTest, WhoMayNotSpeakLeavesRoomToThoseWhoMay) {
  limits_.max_members = 20;
  limits_.max_bytes = 100 * Rooms::kMemberBytes;
  const auto enter_silently = [&](const std::string& room, const std::string& holder) {
    return rooms_.enter({room, "Eve"}, {holder, "proof", {}, false}, limits_).has_value();
  };
  Person ada = enter("Ada"), bob = enter("Bob", "bob");
  ASSERT_TRUE(say(bob, {{"pin", "1"}}, true));
  rooms_.leave("a", bob.seat);
  int own = 0, others = 0;
  while (enter_silently("a", "eve")) ++own;
  EXPECT_EQ(own, 3) << "a quarter of what is free of three quarters";
  while (enter_silently("a", "holder " + std::to_string(others))) ++others;
  EXPECT_EQ(own + others, 15);
  EXPECT_EQ(look(ada).members.size(), 17U);
  EXPECT_TRUE(ada.known.members.contains(bob.seat.member)) << "what Bob kept is there still";
  for (int i = 0; i < 4; ++i) EXPECT_TRUE(try_to_enter("Speaker", "speaker " + std::to_string(i))) << i;
  EXPECT_FALSE(try_to_enter("Speaker", "another"));
  int rooms = 0;
  while (enter_silently("room " + std::to_string(rooms), "holder " + std::to_string(rooms))) ++rooms;
  EXPECT_LE(own + others + rooms, 75);
  EXPECT_TRUE(rooms_.say({"a", {{"note", '"' + std::string(500, 'x') + '"'}}}, ada.seat, limits_));
}

TEST_F(RoomsTest, WhoHasBeenSilentGetsWhatIsThenTrue) {
  Person ada = enter("Ada"), slow = enter("Slow");
  look(slow);
  std::uint64_t random = 7;
  const auto below = [&](std::uint64_t n) { return ((random = random * 6364136223846793005U + 1) >> 33) % n; };
  std::vector<Person> others;
  for (int i = 0; i < 3000; ++i) {
    const std::uint64_t what = below(8);
    Person& who = others.empty() || what == 0 ? ada : others[below(others.size())];
    if (what == 1 && others.size() < 10) others.push_back(enter("P" + std::to_string(i), "p" + std::to_string(i)));
    if (what == 2 && !others.empty()) {
      rooms_.leave("a", others.back().seat);
      others.pop_back();
    }
    if (what == 3) (void)rooms_.take({"a", "lead", below(2) == 0}, who.seat);
    if (what > 3) {
      const std::string key = "k" + std::to_string(below(4));
      (void)say(who, {{key, what == 4 ? "null" : std::to_string(i)}}, what == 5);
    }
    if (i % 17 == 0) look(ada);
    if (i % 701 == 0) look(slow);
  }
  Person fresh = enter("Fresh", "fresh");
  look(fresh);
  EXPECT_EQ(look(ada), fresh.known);
  EXPECT_EQ(look(slow), fresh.known);
  EXPECT_GT(fresh.known.members.size(), 2U);
}

TEST_F(RoomsTest, LongNewsAreCut) {
  limits_.max_room_bytes = 1 << 20;
  Person ada = enter("Ada"), bob = enter("Bob");
  const std::string note = '"' + std::string(2000, 'x') + '"';
  for (std::size_t i = 0; i < limits::kMaxRoomKeys; ++i) ASSERT_TRUE(say(ada, {{"k" + std::to_string(i), note}}));
  const auto texts = rooms_.news("a", bob.seat);
  EXPECT_GT(texts.size(), 2U);
  for (const auto& text : texts) EXPECT_LT(text->size(), limits::kMaxControlBytes);
  bob.known.take(texts);
  EXPECT_EQ(bob.known.members.at(ada.seat.member).values.size(), limits::kMaxRoomKeys);
}

}  // namespace
}  // namespace eigencast::broker
