// SPDX-License-Identifier: MIT
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/thread_pool.hpp>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "broker/backbone/backbone.h"
#include "broker/config/config.h"
#include "broker/relay/ownership.h"

namespace eigencast::broker {

/// Binds the backbone to NATS, the event loop and the store. Belongs to the loop.
class Member {
 public:
  struct Host {
    boost::asio::io_context& loop;
    boost::asio::thread_pool& disk;
    EpochSource& epochs;
    Hub& hub;
    FairReads& memory_reads;
    std::function<bool()> replaces, remembers;
    std::function<void()> frames_came;
  };

  /// Checks the settings of [backbone] and its files. Opens no connection.
  static Result<void> check(const Config& config);

  /// Opens no connection yet. `run`: unique per run. The store outlives it. Errors: see make_nats_link().
  static Result<std::unique_ptr<Member>> create(const Config& config, const std::string& run, AssetStore& assets,
                                                LogSink log);

  /// REQUIRES: `host` outlives stop(), and the disk's threads have ended by then.
  void start(const Host& host);
  void stop();

  Backbone& backbone() { return *backbone_; }

 private:
  Member() = default;
  void tick();

  std::optional<Host> host_;
  std::shared_ptr<Link> link_;
  std::unique_ptr<AssetExchange> exchange_;
  std::unique_ptr<Backbone> backbone_;
  std::optional<boost::asio::steady_timer> timer_;
};

}  // namespace eigencast::broker
