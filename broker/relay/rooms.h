// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "broker/relay/outbox.h"
#include "broker/relay/shares.h"
#include "common/core/result.h"
#include "common/wire/control.h"

namespace eigencast::broker {

/// The rooms of a broker: who is in each, and the last value of each key of each member. What a member has not been
/// told of is computed from versions when it is asked for: so nothing waits for who is slow, and what was replaced
/// meanwhile is never sent. All that are asked for at one moment share the same bytes.
///
/// Members say what is their own. What they say with `keep` stays when they leave, and may then be removed by all. A
/// floor is one member's: the last one's who took it. A room ends with the last member that is here. Thread-safe.
class Rooms {
 public:
  /// Bytes are charged as rooms.max_room_bytes says.
  struct Limits {
    std::int64_t max_members = 256, max_room_bytes = 512 * 1024, max_bytes = 16 * 1024 * 1024;
  };
  /// Of a connection in a room; void once another has taken it over, or it was given up.
  struct Seat {
    std::uint32_t member = 0;
    std::uint64_t session = 0;
  };
  struct Entrant {
    std::string holder;  ///< Who pays; empty: who is spared.
    std::string proof;   ///< Of the secret with which the place can be taken over.
    std::string former;  ///< Of the secret that it shows; empty: none.
    bool speaks = true;  ///< Those who may not leave room to those who may.
  };
  static constexpr std::int64_t kMemberBytes = 1024, kValueBytes = 128;  ///< A floor and a removed value also take 128.
  static constexpr std::size_t kMessageBytes = 48 * 1024;  ///< News are cut into messages of about so much.

  explicit Rooms(std::uint32_t last_member = 0) : last_member_(last_member) {}

  /// Errors: kTooLarge (max_members, max_bytes; max_room_bytes).
  Result<Seat> enter(const control::Enter& wish, const Entrant& who, const Limits& limits);
  /// It is called otherwise. Errors: kNotFound.
  Result<void> rename(const control::Enter& wish, const Seat& seat);
  /// All of it or nothing. Errors: kTooLarge (a value, keys, max_room_bytes, max_bytes), kRefused (values of another
  /// member that is here, or new ones of one that is gone), kNotFound.
  Result<void> say(const control::Say& what, const Seat& seat, const Limits& limits);
  /// Floors that nobody has make room. Errors: kTooLarge (limits::kMaxRoomFloors, half of what is free), kRefused (to
  /// give back what another has), kNotFound.
  Result<void> take(const control::Floor& floor, const Seat& seat);
  void leave(const std::string& room, const Seat& seat);
  /// What has changed since the last call for this seat: framed messages, none: nothing. At first: everything.
  std::vector<Outbox::Text> news(const std::string& room, const Seat& seat);

  std::size_t size() const;
  std::size_t members() const;  ///< That are here.
  std::int64_t bytes() const { return bytes_.used(); }

 private:
  using Version = std::uint64_t;
  struct Value {
    std::string json;
    Version version = 0, since = 0;  ///< Of the value, and since when the key has one.
    bool keep = false;
  };
  struct Member {
    std::string name, colour, proof, holder;
    std::uint64_t session = 0;
    bool here = true;
    Version version = 0;  ///< Of name, colour and here.
    Version since = 0;    ///< When it came.
    Version told = 0;     ///< Up to which it knows the room; 0: nothing, it gets everything.
    std::map<std::string, Value> values;
    std::int64_t bytes = 0;
    std::shared_ptr<void> charge;
    std::shared_ptr<void> silence;  ///< Counts its bytes as those of one who may not speak. Null: it may.
  };
  struct Floor {
    std::uint32_t member = 0;
    Version version = 0;
    std::string holder{};  ///< Who made it.
    std::shared_ptr<void> charge{};
  };
  struct Removed {
    Version version = 0, since = 0;  ///< Whoever was told of a version between knows what was removed.
    std::uint32_t member = 0;
    std::string key;  ///< Empty: the member.
    std::shared_ptr<void> charge;
  };
  struct Room {
    Version version = 0;
    Version heard = 0;  ///< The latest that anybody has been told of.
    std::map<std::uint32_t, Member> members;
    std::map<std::string, Floor> floors;
    std::deque<Removed> removed;  ///< Oldest first.
    std::int64_t bytes = 0;
    Version made_from = 0, made_at = 0;  ///< Of `made`.
    std::vector<Outbox::Text> made;
  };
  using Entry = std::map<std::string, Room>::iterator;

  struct Found {
    Room* room = nullptr;
    Member* member = nullptr;
  };
  Result<Found> find(const std::string& room, const Seat& seat);
  struct More {
    std::int64_t members = 0, said = 0;
    bool speaks = true;
  };
  /// So much more, where those who have left make room: each holder that is here has its share. Errors: kTooLarge.
  static Result<void> may_hold(const Room& room, const std::string& holder, const More& more, const Limits& limits);
  /// Drops who has left until there is room for so much more. Errors: kTooLarge, and nobody is dropped.
  Result<void> make_room(Room& room, const std::string& holder, const More& more, const Limits& limits);
  void charge(Room& room, Member& member, std::int64_t bytes);
  /// Of what was there `since` then, and is not any more.
  void note_removed(Room& room, std::uint32_t member, const std::string& key, Version since, const std::string& holder);
  /// Removed ones that all know of.
  static void forget_heard(Room& room);
  /// Errors: kTooLarge.
  static Result<void> may_take(Room& room, const std::string& holder);
  void erase(Room& room, std::uint32_t member, const std::string& key);
  void drop(Room& room, std::uint32_t member);
  static std::vector<Outbox::Text> texts_since(const std::string& name, const Room& room, Version since);

  mutable std::mutex mutex_;
  Shares bytes_, silent_bytes_;
  std::map<std::string, Room> rooms_;  ///< GUARDED_BY(mutex_)
  std::uint32_t last_member_ = 0;      ///< GUARDED_BY(mutex_)
  std::uint64_t last_session_ = 0;     ///< GUARDED_BY(mutex_)
};

}  // namespace eigencast::broker
