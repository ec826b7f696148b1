// SPDX-License-Identifier: MIT
#include "broker/relay/rooms.h"

#include <algorithm>
#include <utility>

#include "broker/websocket/protocol.h"
#include "common/core/share.h"
#include "common/wire/limits.h"

namespace eigencast::broker {
namespace {

constexpr std::size_t kMaxRemoved = 1024;
constexpr std::string_view kNothing = "null";

/// Of a limit, what those may have together who may not speak.
std::int64_t silent_part_of(std::int64_t max) {
  return std::max<std::int64_t>(max / 4 * 3, 1);
}

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
  void gone(std::uint32_t member) {
    constexpr std::size_t kIdBytes = 11;
    if ((bytes_ += kIdBytes) > Rooms::kMessageBytes || message_.gone.size() == limits::kMaxRoomMembers) flush();
    message_.gone.push_back(member);
  }
  /// To which so many bytes are added.
  control::Room::Member& member(std::uint32_t id, bool here, std::size_t bytes) {
    constexpr std::size_t kAroundBytes = 128;
    if (bytes_ + bytes > Rooms::kMessageBytes || message_.members.size() == limits::kMaxRoomMembers) flush();
    bytes_ += bytes + kAroundBytes;
    const auto& last = message_.members;
    if (last.empty() || last.back().id != id || last.back().values.size() == limits::kMaxRoomKeys)
      message_.members.push_back({id});
    message_.members.back().here = here;
    return message_.members.back();
  }
  std::vector<Outbox::Text> finished() {
    if (message_.whole || !message_.members.empty() || !message_.gone.empty() || !message_.floors.empty()) flush();
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

Result<void> Rooms::may_hold(const Room& room, const std::string& holder, const More& more, const Limits& limits) {
  const auto [members, said, speaks] = more;
  struct {
    std::int64_t members = 0, silent = 0, bytes = 0, said = 0;
  } here, own;  // Of those that are here: the others make room.
  for (const auto& [id, member] : room.members) {
    if (!member.here) continue;
    for (auto* sum : {&here, member.holder == holder ? &own : nullptr}) {
      if (sum == nullptr) continue;
      ++sum->members;
      sum->silent += member.silence ? 1 : 0;
      sum->bytes += member.bytes;
      sum->said += member.bytes - kMemberBytes;
    }
  }
  if (members > 0 && own.members + members > share_of(limits.max_members, here.members, own.members, holder.empty()))
    return too_large("the room is full, or too full for one that has several in it: see rooms.max_members = " +
                     std::to_string(limits.max_members));
  const std::int64_t max_silent = silent_part_of(limits.max_members);
  if (members > 0 && !speaks && own.silent + members > share_of(max_silent, here.silent, own.silent, holder.empty()))
    return too_large("of those who may not speak " + std::to_string(here.silent) +
                     " are in the room, and too few of the " + std::to_string(max_silent) +
                     " places for them (three of four of rooms.max_members) are free for one that has several");
  const std::int64_t used = here.bytes + members * kMemberBytes;
  if (used + said > limits.max_room_bytes ||
      (said > 0 && own.said + said > share_of(limits.max_room_bytes, used, own.said, holder.empty())))
    return too_large("too much is said in the room, or by one that has said much: see rooms.max_room_bytes = " +
                     std::to_string(limits.max_room_bytes) + "; remove notes, or write shorter ones");
  return {};
}

Result<void> Rooms::make_room(Room& room, const std::string& holder, const More& more, const Limits& limits) {
  if (auto may = may_hold(room, holder, more, limits); !may) return may;
  const std::int64_t bytes = more.members * kMemberBytes + more.said;
  if (!bytes_.fits(holder, bytes, limits.max_bytes) ||
      (!more.speaks && !silent_bytes_.fits(holder, bytes, silent_part_of(limits.max_bytes))))
    return too_large("of rooms.max_bytes = " + std::to_string(limits.max_bytes) +
                     " too few are free for one that holds more: try again later");
  const auto full = [&] {
    return static_cast<std::int64_t>(room.members.size()) + more.members > limits.max_members ||
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

void Rooms::note_removed(Room& room, std::uint32_t id, const std::string& key, Version since,
                         const std::string& holder) {
  if (room.heard < since) return;  // Nobody has been told of it.
  room.removed.push_back({++room.version, since, id, key, bytes_.hold(holder, kValueBytes)});
  if (room.removed.size() <= kMaxRemoved) return;
  for (auto& [other, member] : room.members) {
    const Removed& lost = room.removed.front();  // Who would miss it gets everything.
    if (member.told >= lost.since && member.told < lost.version) member.told = 0;
  }
  room.removed.pop_front();
}

void Rooms::forget_heard(Room& room) {
  if (room.removed.empty()) return;
  Version least = room.version;
  for (const auto& [id, member] : room.members) {
    if (member.here && member.told != 0) least = std::min(least, member.told);
  }
  while (!room.removed.empty() && room.removed.front().version <= least) room.removed.pop_front();
}

void Rooms::erase(Room& room, std::uint32_t id, const std::string& key) {
  Member& member = room.members.at(id);
  const auto value = member.values.find(key);
  if (value == member.values.end()) return;
  charge(room, member, -value_bytes(key, value->second.json));
  const Version since = value->second.since;
  member.values.erase(value);
  note_removed(room, id, key, since, member.holder);
}

void Rooms::drop(Room& room, std::uint32_t id) {
  const Member member = std::move(room.members.extract(id).mapped());
  room.bytes -= member.bytes;
  note_removed(room, id, {}, member.since, member.holder);
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
      !may_hold(room, who.holder, {1, former->second.bytes - kMemberBytes, who.speaks}, limits))
    former = room.members.end();
  if (former == room.members.end()) {
    if (auto made = make_room(room, who.holder, {1, 0, who.speaks}, limits); !made) {
      if (room.members.empty()) rooms_.erase(wish.room);
      return made.error();
    }
  }
  const bool is_new = former == room.members.end();
  while (is_new && (++last_member_ == 0 || room.members.contains(last_member_))) continue;  // It has wrapped around.
  const std::uint32_t id = is_new ? last_member_ : former->first;
  Member& member = room.members[id];
  member.name = wish.name;
  member.colour = wish.colour;
  member.proof = who.proof;
  member.holder = who.holder;
  member.silence = who.speaks ? nullptr : silent_bytes_.hold(who.holder, kMemberBytes);
  member.here = true;
  member.session = ++last_session_;
  member.version = ++room.version;
  if (is_new) member.since = member.version;
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
    if (auto made = make_room(room, member.holder, {0, more}, limits); !made) return made;
  }
  forget_heard(room);
  for (const control::RoomValue& value : what.values) {
    if (value.json == kNothing) {
      erase(room, id, value.key);
      continue;
    }
    const auto [at, is_new] = member.values.try_emplace(value.key);
    if (!is_new && at->second.json == value.json && at->second.keep == what.keep) continue;
    charge(room, member, value_bytes(value.key, value.json) - (is_new ? 0 : value_bytes(value.key, at->second.json)));
    ++room.version;
    at->second = {value.json, room.version, is_new ? room.version : at->second.since, what.keep};
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
    known->second.member = 0;
    known->second.version = ++room.version;
    return {};
  }
  if (known != room.floors.end()) {
    if (std::exchange(known->second.member, seat.member) != seat.member) known->second.version = ++room.version;
    return {};
  }
  const std::string& holder = found->member->holder;
  if (auto may = may_take(room, holder); !may) return may;
  room.floors[floor.floor] = {seat.member, ++room.version, holder, bytes_.hold(holder, kValueBytes)};
  return {};
}

Result<void> Rooms::may_take(Room& room, const std::string& holder) {
  // Those that nobody has, and all know it, make room.
  std::erase_if(room.floors, [&](const auto& floor) {
    return floor.second.member == 0 && std::none_of(room.members.begin(), room.members.end(), [&](const auto& each) {
             return each.second.here && each.second.told != 0 && each.second.told < floor.second.version;
           });
  });
  const auto own = static_cast<std::size_t>(std::count_if(room.floors.begin(), room.floors.end(),
                                                          [&](auto& floor) { return floor.second.holder == holder; }));
  const std::size_t free = limits::kMaxRoomFloors - room.floors.size();
  if (free > 0 && (holder.empty() || own < std::max<std::size_t>((free + own) / 2, 1))) return {};
  return too_large("a room has at most " + std::to_string(limits::kMaxRoomFloors) +
                   " floors, and too few are free for one that has made several");
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
    if (held.member != seat.member) continue;
    held.member = 0;
    held.version = ++room.version;
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
  room.heard = room.version;
  const Version since = std::exchange(found->member->told, room.version);  // 0: everything.
  if (since == room.version) return {};
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
  const auto unheard = std::partition_point(room.removed.begin(), room.removed.end(),
                                            [&](const Removed& each) { return each.version <= since; });
  for (auto each = whole ? room.removed.end() : unheard; each != room.removed.end(); ++each) {
    const Removed& removed = *each;
    if (removed.since > since) continue;  // It came and went unheard.
    const auto member = room.members.find(removed.member);
    if (removed.key.empty()) {
      writer.gone(removed.member);
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
