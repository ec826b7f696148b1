// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>

#include "common/core/clock.h"
#include "common/core/log.h"
#include "common/core/result.h"
#include "common/net/url.h"
#include "common/wire/control.h"

namespace eigencast {

/// What is known of a room (docs/protocol.md, "room").
struct RoomState {
  struct Member {
    std::string name, colour;
    bool here = true;
    std::map<std::string, std::string> values{};  ///< JSON by key.
  };
  bool open = false;       ///< It is in the room now.
  std::uint32_t self = 0;  ///< 0: not yet.
  bool speaks = false;
  std::string trouble;  ///< What the broker said last, or why there is no connection; empty: all is well.
  std::map<std::uint32_t, Member> members;
  std::map<std::string, std::uint32_t> floors;
  std::uint64_t version = 0;  ///< Grows with each change.

  /// Ignores what is beyond the protocol's limits, so that a broker or member makes no viewer's memory grow.
  void take(const control::Room& news);
  /// Null: nobody has it, or who has is gone.
  const Member* holder_of(const std::string& floor) const;
};

/// One's place in a room of a broker, over the connection of its streams. It comes back after a loss, with all that was
/// said before. What is said goes out at most ten times a second, the last of each key. Thread-safe.
class RoomClient {
 public:
  /// url: of the broker; its stream does not count. Errors: kInvalidArgument (URL, names).
  static Result<std::unique_ptr<RoomClient>> enter(const std::string& url, const Credentials& credentials,
                                                   control::Enter wish, LogSink log = {});
  virtual ~RoomClient() = default;  ///< Leaves.

  /// Changes it if it is not of this version.
  virtual void read(RoomState& state) const = 0;
  /// json: "null" removes it. Ignored where it was said last. See control::Say.
  virtual void say(const std::string& key, const std::string& json, bool keep = false) = 0;
  /// What somebody kept who has left.
  virtual void remove(std::uint32_t member, const std::string& key) = 0;
  virtual void take(const std::string& floor, bool take = true) = 0;
};

}  // namespace eigencast
