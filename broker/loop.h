// SPDX-License-Identifier: MIT
#pragma once

#include <boost/asio/io_context.hpp>
#include <exception>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "broker/context.h"

namespace eigencast::broker {

/// One event loop: its streams and connections, what leaves at the end of its turns, and the timers of both. Runs on
/// one thread, its owner's choice.
class Loop {
 public:
  /// What all loops of a broker have in common; outlives them.
  struct Common {
    asio::thread_pool& disk;
    Gate& gate;
    AssetStore& assets;
    Recorder& recorder;
    Ownership& ownership;
    const Backbone* backbone;
    LogSink log;
    std::string version;
    std::string session_id;
  };
  /// It among the others.
  struct Place {
    Loops& loops;
    std::shared_ptr<StreamIds> ids;
    std::atomic<std::uint64_t>& last_connection_id;
  };

  /// `taps`, `on_opened`: of its streams, see Stream::Settings and Hub::Settings.
  Loop(const Config& config, const Common& common, const Place& place, std::vector<StreamTap*> taps,
       std::function<void(Stream&)> on_opened);
  Loop(const Loop&) = delete;
  Loop& operator=(const Loop&) = delete;

  Context& context() { return context_; }
  const Context& context() const { return context_; }
  asio::io_context& io() { return io_; }
  Hub& hub() { return hub_; }

  /// Takes what the kernel offers, on the thread that is to run().
  void begin();
  /// Until stop(). What one handler could not do (no memory) must not end the streams of all others: its own work is
  /// lost, the loop goes on.
  void run();
  /// Does a part of a handler's work that what follows it must not be lost with. On the loop's thread.
  void guarded(const std::function<void()>& work) noexcept;
  /// From any thread.
  void stop() { io_.stop(); }
  /// Something has come that may be due before what was.
  void arm_schedule();

 private:
  void tick();
  void log_failure(const std::exception& exception) noexcept;

  Hub hub_;
  Context context_;  // What waits in the loop below ends with it and needs all above.
  asio::io_context io_;
  Turn turn_;
  Timer schedule_;
  std::optional<TimeUs> scheduled_us_;
  TimeUs pumped_us_ = 0;
  Timer tick_;
};

}  // namespace eigencast::broker
