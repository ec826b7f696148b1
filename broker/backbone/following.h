// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <string_view>

#include "broker/backbone/asset_exchange.h"
#include "broker/backbone/directory.h"
#include "broker/backbone/link.h"
#include "broker/relay/hub.h"
#include "common/core/log.h"

namespace eigencast::broker {

class Remote;

/// The streams of other brokers that viewers of this one watch.
///
/// Each is fed in the place of a sender: its surface is copied first, then its frames are subscribed to, and a join is
/// asked of its owner, again after each gap. What should be followed comes from the directory, time and again.
///
/// Not thread-safe: belongs to the event loop, as the part of Backbone that it is.
class Following {
 public:
  struct Settings {
    std::string self;    ///< Id of this broker.
    std::string prefix;  ///< Of all subjects.
    TimeUs retry_us = 0, linger_us = 0;
  };
  struct Surroundings {
    std::function<TimeUs()> now_us;
    std::function<void()> frames_came;
    LogSink log;
  };
  struct Totals {
    std::uint64_t streams = 0, frames = 0, frames_dropped = 0, joins_asked = 0;
  };

  /// link and assets outlive it.
  Following(Settings settings, Link& link, AssetExchange& assets, Surroundings surroundings);
  ~Following();

  /// REQUIRES: the hub lives until stop().
  void start(Hub& hub) { hub_ = &hub; }
  /// Streams end: nobody feeds them any more.
  void stop();

  /// Feeds `stream` from the broker of `entry`, in place of whoever fed it.
  void follow(Stream& stream, const DirectoryEntry& entry);
  /// Whether the stream of that name is fed from another broker.
  bool feeds(std::string_view name) const;
  /// That stream is no more.
  void forget_stream(std::string_view name);

  /// Follows what is watched here and sent elsewhere, and lets go what is not.
  /// complete  whether the directory is known whole: only then an entry that is absent counts
  void reconcile(const Directory& directory, bool connected, bool complete);

  Totals totals() const;

 private:
  using RemotePtr = std::shared_ptr<Remote>;

  void let_go(const Directory& directory, bool complete);
  void take_up(const Directory& directory);
  void unfollow(const std::string& name);
  void advance(const RemotePtr& remote);
  void fetch_surface(const RemotePtr& remote);
  void begin(const RemotePtr& remote);
  void ask_join(const RemotePtr& remote);
  void take(Remote& remote, Bytes message);
  void say(LogLevel level, const std::string& text) const;

  const Settings settings_;
  Link& link_;
  AssetExchange& assets_;
  const Surroundings surroundings_;
  Hub* hub_ = nullptr;
  std::map<std::string, RemotePtr, std::less<>> remotes_;
  Totals totals_;
};

}  // namespace eigencast::broker
