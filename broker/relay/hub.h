// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "broker/relay/stream.h"

namespace eigencast::broker {

/// All streams of an event loop by name.
///
/// A stream that nobody publishes, nobody watches and that never had a pose is forgotten; one that holds a last pose
/// stays until the room is needed. Not thread-safe: belongs to one event loop.
class Hub {
 public:
  struct Settings {
    std::size_t max_streams = 1024;  ///< (default: 1,024)
    Stream::Settings stream{};
    std::shared_ptr<StreamIds> ids{};             ///< Of all hubs of a broker (default: this one is alone).
    std::function<void(Stream&)> on_opened = {};  ///< A stream was made that nobody publishes or watches yet.
  };

  explicit Hub(const Settings& settings) : settings_(settings) {
    if (!settings_.ids) settings_.ids = std::make_shared<StreamIds>();
  }

  /// The stream of that name, made if there is none. REQUIRES: check_stream_name passed. Errors: kTooLarge
  /// (max_streams).
  Result<Stream*> open(std::string_view name);
  /// Null if there is none.
  Stream* find(std::string_view name);
  /// Call when a publisher or watcher has left `stream`: it may be forgotten, and the pointer is dead then.
  void left(Stream& stream);
  /// Forgets it, whatever pose it holds. REQUIRES: nobody publishes or watches it.
  void drop(Stream& stream);

  /// Pumps the streams that have something due by now.
  void pump(TimeUs now_us);
  /// The stream took frames or watchers: deliver() delivers what follows and learns when it has something due next.
  void owes(Stream& stream);
  void deliver();
  /// Call when what the last deliver() made has left: the poses that its streams will need soon are made
  /// (Feed::prepare).
  void prepare();
  /// When pump() has something to do next.
  std::optional<TimeUs> next_due_us() const;

  /// In the order of their names; valid until the next open() or left().
  std::vector<const Stream*> streams() const;
  std::size_t size() const { return streams_.size(); }

 private:
  /// Asks the stream when it has something due next.
  void schedule(Stream& stream);
  void unschedule(Stream& stream);
  bool make_room();
  void forget(std::map<std::string, std::unique_ptr<Stream>, std::less<>>::iterator stream);

  Settings settings_;
  std::map<std::string, std::unique_ptr<Stream>, std::less<>> streams_;
  std::vector<Stream*> owing_;
  std::vector<Stream*> delivered_;            ///< By the last deliver(), and not prepared since.
  std::set<std::pair<TimeUs, Stream*>> due_;  ///< Each stream that waits for a time: Stream::wake_us_.
  std::vector<Stream*> pumping_;              ///< Scratch.
};

}  // namespace eigencast::broker
