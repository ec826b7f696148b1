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

/// The streams of other brokers that local viewers watch; a part of Backbone.
///
/// Acts as the sender of each: copies its surface, subscribes to its frames, and requests a join from its owner at the
/// start and after each gap. Belongs to the event loop.
class Following {
 public:
  struct Settings {
    std::string self;    ///< Id of this broker.
    std::string prefix;  ///< Prefix of all subjects.
    TimeUs retry_us = 0, linger_us = 0;
  };
  struct Environment {
    std::function<TimeUs()> now_us;
    std::function<void()> frames_came;
    LogSink log;
  };
  struct Totals {
    std::uint64_t streams = 0, frames = 0, frames_dropped = 0, joins_asked = 0;
  };

  /// link and assets outlive it.
  Following(Settings settings, Link& link, AssetExchange& assets, Environment environment);
  ~Following();

  /// REQUIRES: the hub lives until stop().
  void start(Hub& hub) { hub_ = &hub; }
  void stop();

  /// Feeds `stream` from the broker of `entry`, replacing its publisher.
  void follow(Stream& stream, const DirectoryEntry& entry);
  bool feeds(std::string_view name) const;
  void forget_stream(std::string_view name);

  /// Follows remote streams that are watched here and no others. `complete`: absent entries of the directory count.
  void reconcile(const Directory& directory, bool connected, bool complete);

  Totals totals() const;

 private:
  class Remote;
  using RemotePtr = std::shared_ptr<Remote>;

  void stop_unwanted(const Directory& directory, bool complete);
  void start_wanted(const Directory& directory);
  void unfollow(const std::string& name);
  void advance(const RemotePtr& remote);
  void fetch_surface(const RemotePtr& remote);
  void begin(const RemotePtr& remote);
  void ask_join(const RemotePtr& remote);
  void take(Remote& remote, Bytes message);
  void write_log(LogLevel level, const std::string& text) const;

  const Settings settings_;
  Link& link_;
  AssetExchange& assets_;
  const Environment environment_;
  Hub* hub_ = nullptr;
  std::map<std::string, RemotePtr, std::less<>> remotes_;
  Totals totals_;
};

}  // namespace eigencast::broker
