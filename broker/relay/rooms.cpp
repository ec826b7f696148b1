// SPDX-License-Identifier: MIT
#include "broker/relay/rooms.h"

#include <algorithm>
#include <utility>

#include "broker/websocket/protocol.h"
#include "common/core/share.h"
#include "common/wire/limits.h"

namespace eigencast::broker {
namespace {

constexpr std::size_t kMaxRemoved = 256;
constexpr std::string_view kNothing = "null";

std::int64_t value_bytes(const std::string& key, const std::string& json) {
  return 2 * static_cast<std::int64_t>(key.size() + json.size()) + Rooms::kValueBytes;
}

Error too_large(const std::string& what) {
  return fail(ErrorCode::kTooLarge, what);
}

/// Cuts news into messages.
class NewsWriter {
 public:
  NewsWriter(const std::string& room, bool whole) {
    message_.room = room;
    message_.whole = whole;
  }
  control::Room& message() { return message_; }
  /// To which so many bytes are added.
  control::Room::Member& member(std::uint32_t id, bool here, std::size_t bytes) {
    constexpr std::size_t kAroundBytes = 128;
    if (bytes_ + bytes > Rooms::kMessageBytes) flush();
    bytes_ += bytes + kAroundBytes;
    if (message_.members.empty() || message_.members.back().id != id) message_.members.push_back({id});
    message_.members.back().here = here;
    return message_.members.back();
  }
  std::vector<Outbox::Text> finished() {
    flush();
    return std::move(texts_);
  }

 private:
  void flush() {
    control::Room rest;
    rest.room = message_.room;
    texts_.push_back(websocket::framed(websocket::Opcode::kText, text_from_control(std::move(message_))));
    message_ = std::move(rest);
    bytes_ = 0;
  }
  control::Room message_;
  std::size_t bytes_ = 0;
  std::vector<Outbox::Text> texts_;
};

}  // namespace

Result<Rooms::Found> Rooms::find(const std::string& room, const Seat& seat) {
  const auto found = rooms_.find(room);
  if (found != rooms_.end()) {
    const auto member = found->second.members.find(seat.member);
    if (member != found->second.members.end() && member->second.here && member->second.session == seat.session)
      return Found{&found->second, &member->second};
  }
  return fail(ErrorCode::kNotFound, "this connection is not in room '" + room +
                                        "': enter it, again if its place was "
                                        "taken over by another connection");
}

Result<void> Rooms::may_hold(const Room& room, const std::string& holder, std::int64_t members, std::int64_t said,
                             const Limits& limits) {
  struct {
    std::int64_t members = 0, bytes = 0, said = 0;
  } here, own;  // Of those that are here: the others make room.
  for (const auto& [id, member] : room.members) {
    if (!member.here) continue;
    for (auto* sum : {&here, member.holder == holder ? &own : nullptr}) {
      if (sum == nullptr) continue;
      ++sum->members;
      sum->bytes += member.bytes;
      sum->said += member.bytes - kMemberBytes;
    }
  }
  if (members > 0 && own.members + members > share_of(limits.max_members, here.members, own.members, holder.empty()))
    return too_large("the room is full, or too full for one that has several in it: see rooms.max_members = " +
                     std::to_string(limits.max_members));
  const std::int64_t used = here.bytes + members * kMemberBytes;
  if (used + said > limits.max_room_bytes ||
      (said > 0 && own.said + said > share_of(limits.max_room_bytes, used, own.said, holder.empty())))
    return too_large("too much is said in the room, or by one that has said much: see rooms.max_room_bytes = " +
                     std::to_string(limits.max_room_bytes) + "; remove notes, or write shorter ones");
  return {};
}

Result<void> Rooms::make_room(Room& room, const std::string& holder, std::int64_t members, std::int64_t said,
                              const Limits& limits) {
  if (auto may = may_hold(room, holder, members, said, limits); !may) return may;
  const std::int64_t bytes = members * kMemberBytes + said;
  if (!bytes_.fits(holder, bytes, limits.max_bytes))
    return too_large("of rooms.max_bytes = " + std::to_string(limits.max_bytes) +
                     " too few are free for one that holds more: try again later");
  const auto full = [&] {
    return static_cast<std::int64_t>(room.members.size()) + members > limits.max_members ||
           room.bytes + bytes > limits.max_room_bytes;
  };
  while (full()) {
    const auto left = std::find_if(room.members.begin(), room.members.end(), [](auto& m) { return !m.second.here; });
    if (left == room.members.end()) break;  // A reload has made limits less.
    drop(room, left->first);
  }
  return {};
}

void Rooms::charge(Room& room, Member& member, std::int64_t bytes) {
  room.bytes += bytes;
  member.bytes += bytes;
  member.charge = bytes_.hold(member.holder, member.bytes);
}

void Rooms::note_removed(Room& room, std::uint32_t member, const std::string& key) {
  room.removed.push_back({++room.version, member, key});
  if (room.removed.size() <= kMaxRemoved) return;
  room.forgotten = room.removed.front().version;
  room.removed.pop_front();
}

void Rooms::erase(Room& room, std::uint32_t id, const std::string& key) {
  Member& member = room.members.at(id);
  const auto value = member.values.find(key);
  if (value == member.values.end()) return;
  charge(room, member, -value_bytes(key, value->second.json));
  member.values.erase(value);
  note_removed(room, id, key);
}

void Rooms::drop(Room& room, std::uint32_t id) {
  room.bytes -= room.members.at(id).bytes;
  room.members.erase(id);
  note_removed(room, id, {});
}

Result<Rooms::Seat> Rooms::enter(const control::Enter& wish, const Entrant& who, const Limits& limits) {
  const std::lock_guard lock(mutex_);
  Room& room = rooms_[wish.room];
  auto former =
      who.former.empty() ? room.members.end() : std::find_if(room.members.begin(), room.members.end(), [&](auto& each) {
        return each.second.proof == who.former && each.second.holder == who.holder;
      });
  // With what it kept it may be too much for one holder that is here: then its former place stays as it left it.
  if (former != room.members.end() && !former->second.here &&
      !may_hold(room, who.holder, 1, former->second.bytes - kMemberBytes, limits))
    former = room.members.end();
  if (former == room.members.end()) {
    if (auto made = make_room(room, who.holder, 1, 0, limits); !made) {
      if (room.members.empty()) rooms_.erase(wish.room);
      return made.error();
    }
  }
  const std::uint32_t id = former == room.members.end() ? ++last_member_ : former->first;
  Member& member = room.members[id];
  member.name = wish.name;
  member.colour = wish.colour;
  member.proof = who.proof;
  member.holder = who.holder;
  member.here = true;
  member.session = ++last_session_;
  member.version = ++room.version;
  member.told = 0;
  if (member.bytes == 0) charge(room, member, kMemberBytes);
  return Seat{id, member.session};
}

Result<void> Rooms::rename(const control::Enter& wish, const Seat& seat) {
  const std::lock_guard lock(mutex_);
  const auto found = find(wish.room, seat);
  if (!found) return found.error();
  found->member->name = wish.name;
  found->member->colour = wish.colour;
  found->member->version = ++found->room->version;
  return {};
}

Result<void> Rooms::say(const control::Say& what, const Seat& seat, const Limits& limits) {
  const std::lock_guard lock(mutex_);
  const auto found = find(what.room, seat);
  if (!found) return found.error();
  Room& room = *found->room;
  const std::uint32_t id = what.member == 0 ? seat.member : what.member;
  const auto whose = room.members.find(id);
  if (whose == room.members.end()) return fail(ErrorCode::kNotFound, "the room has no such member");
  Member& member = whose->second;
  const bool removes = std::all_of(what.values.begin(), what.values.end(), [](auto& v) { return v.json == kNothing; });
  if (id != seat.member && (member.here || !removes))
    return fail(ErrorCode::kRefused,
                "a member changes only what is its own, and removes what those kept who have left");
  std::int64_t more = 0;
  std::size_t keys = member.values.size();
  for (const control::RoomValue& value : what.values) {
    if (value.json.size() > limits::kMaxRoomValueBytes)
      return too_large("the value of '" + value.key + "' has " + std::to_string(value.json.size()) +
                       " bytes, more than " + std::to_string(limits::kMaxRoomValueBytes) + ": write less");
    const auto old = member.values.find(value.key);
    if (old != member.values.end()) more -= value_bytes(value.key, old->second.json);
    if (value.json == kNothing) {
      keys -= old != member.values.end() ? 1 : 0;
      continue;
    }
    more += value_bytes(value.key, value.json);
    keys += old == member.values.end() ? 1 : 0;
  }
  if (keys > limits::kMaxRoomKeys)
    return too_large("a member has at most " + std::to_string(limits::kMaxRoomKeys) + " values: remove some");
  if (more > 0) {
    if (auto made = make_room(room, member.holder, 0, more, limits); !made) return made;
  }
  for (const control::RoomValue& value : what.values) {
    if (value.json == kNothing) {
      erase(room, id, value.key);
      continue;
    }
    const auto [at, is_new] = member.values.try_emplace(value.key);
    if (!is_new && at->second.json == value.json && at->second.keep == what.keep) continue;
    charge(room, member, value_bytes(value.key, value.json) - (is_new ? 0 : value_bytes(value.key, at->second.json)));
    at->second = {value.json, ++room.version, what.keep};
  }
  if (!member.here && member.values.empty()) drop(room, id);
  return {};
}

Result<void> Rooms::take(const control::Floor& floor, const Seat& seat) {
  const std::lock_guard lock(mutex_);
  const auto found = find(floor.room, seat);
  if (!found) return found.error();
  Room& room = *found->room;
  const auto known = room.floors.find(floor.floor);
  if (!floor.take) {
    if (known == room.floors.end() || known->second.member != seat.member)
      return fail(ErrorCode::kRefused, "'" + floor.floor + "' is not this member's to give back: take it first");
    known->second = {0, ++room.version};
    return {};
  }
  if (known == room.floors.end() && room.floors.size() >= limits::kMaxRoomFloors)
    return too_large("a room has at most " + std::to_string(limits::kMaxRoomFloors) + " floors");
  room.floors[floor.floor] = {seat.member, ++room.version};
  return {};
}

void Rooms::leave(const std::string& name, const Seat& seat) {
  const std::lock_guard lock(mutex_);
  const auto found = find(name, seat);
  if (!found) return;
  Room& room = *found->room;
  Member& member = *found->member;
  member.here = false;
  if (std::none_of(room.members.begin(), room.members.end(), [](auto& each) { return each.second.here; }))
    return void(rooms_.erase(name));
  for (auto& [floor, held] : room.floors) {
    if (held.member == seat.member) held = {0, ++room.version};
  }
  std::vector<std::string> own;
  for (const auto& [key, value] : member.values) {
    if (!value.keep) own.push_back(key);
  }
  for (const std::string& key : own) erase(room, seat.member, key);
  if (member.values.empty()) return drop(room, seat.member);
  member.version = ++room.version;
}

std::vector<Outbox::Text> Rooms::news(const std::string& name, const Seat& seat) {
  const std::lock_guard lock(mutex_);
  const auto found = find(name, seat);
  if (!found) return {};
  Room& room = *found->room;
  const Version told = std::exchange(found->member->told, room.version);
  if (told == room.version) return {};
  const Version since = told < room.forgotten ? 0 : told;  // 0: everything.
  if (room.made_at != room.version || room.made_from != since || room.made.empty()) {
    room.made = texts_since(name, room, since);
    room.made_from = since;
    room.made_at = room.version;
  }
  return room.made;
}

std::vector<Outbox::Text> Rooms::texts_since(const std::string& name, const Room& room, Version since) {
  const bool whole = since == 0;
  NewsWriter writer(name, whole);
  for (const auto& [floor, held] : room.floors) {
    if (held.version > since && !(whole && held.member == 0)) writer.message().floors.push_back({floor, held.member});
  }
  for (const Removed& removed : room.removed) {
    if (whole || removed.version <= since) continue;
    const auto member = room.members.find(removed.member);
    if (removed.key.empty()) {
      writer.message().gone.push_back(removed.member);
    } else if (member != room.members.end() && !member->second.values.contains(removed.key)) {
      writer.member(removed.member, member->second.here, removed.key.size())
          .values.push_back({removed.key, std::string(kNothing)});
    }
  }
  for (const auto& [id, member] : room.members) {
    if (member.version > since) {
      control::Room::Member& out = writer.member(id, member.here, member.name.size());
      out.name = member.name;
      out.colour = member.colour;
    }
    for (const auto& [key, value] : member.values) {
      if (value.version > since)
        writer.member(id, member.here, key.size() + value.json.size()).values.push_back({key, value.json});
    }
  }
  return writer.finished();
}

std::size_t Rooms::size() const {
  const std::lock_guard lock(mutex_);
  return rooms_.size();
}

std::size_t Rooms::members() const {
  const std::lock_guard lock(mutex_);
  std::size_t here = 0;
  for (const auto& [name, room] : rooms_)
    here += static_cast<std::size_t>(
        std::count_if(room.members.begin(), room.members.end(), [](auto& each) { return each.second.here; }));
  return here;
}

}  // namespace eigencast::broker
