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
#include "broker/backbone/nats_link.h"
#include "broker/config/config.h"
#include "broker/relay/epoch_source.h"

namespace eigencast::broker {

/// This broker as one of several: its backbone, bound to NATS, the event loop and the store. Belongs to the loop.
class Member {
 public:
  struct Place {
    boost::asio::io_context& loop;
    boost::asio::thread_pool& disk;
    EpochSource& epochs;
    Hub& hub;
    std::function<bool()> replaces;
    std::function<void()> frames_came;
  };

  /// Whether the settings of [backbone] are of use: files are there and can be read. Connects to nobody.
  static Result<void> check(const Config& config);

  /// Connects to nobody yet. `id`: of this run of the broker. The store outlives it. Errors: of [backbone], see
  /// NatsLink.
  static Result<std::unique_ptr<Member>> create(const Config& config, const std::string& id, AssetStore& assets,
                                                LogSink log);

  /// REQUIRES: what `place` names lives until stop() has returned, and the disk's threads have ended by then.
  void start(const Place& place);
  void stop();

  Backbone& backbone() { return *backbone_; }

 private:
  Member() = default;
  void tick();

  std::optional<Place> place_;
  std::unique_ptr<NatsLink> link_;
  std::unique_ptr<AssetExchange> exchange_;
  std::unique_ptr<Backbone> backbone_;
  std::optional<boost::asio::steady_timer> timer_;
};

}  // namespace eigencast::broker
