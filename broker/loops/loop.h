// SPDX-License-Identifier: MIT
#pragma once

#include <boost/asio/io_context.hpp>
#include <exception>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "broker/context/context.h"
#include "broker/relay/hub.h"
#include "broker/sockets/turn.h"

namespace eigencast::broker {

/// One event loop with its streams, connections, writes and timers. Runs on one thread, chosen by its owner.
class Loop {
 public:
  struct Siblings {
    Loops& loops;
    std::shared_ptr<StreamIds> ids;
    std::atomic<std::uint64_t>& last_connection_id;
  };

  Loop(const Config& config, const SharedContext& shared, const Siblings& siblings, std::vector<StreamTap*> taps,
       std::function<void(Stream&)> on_opened);
  Loop(const Loop&) = delete;
  Loop& operator=(const Loop&) = delete;

  Context& context() { return context_; }
  const Context& context() const { return context_; }
  asio::io_context& io() { return io_; }
  Hub& hub() { return hub_; }

  /// Sets up the thread that will run().
  void begin();
  /// Runs until stop(). An exception of one handler (no memory) is logged, and the loop goes on.
  void run();
  /// Runs `work` and logs its exception, so that the code after it runs. On the loop's thread.
  void guarded(const std::function<void()>& work) noexcept;
  void stop() { io_.stop(); }
  /// Call when a stream may be due earlier than scheduled.
  void arm_schedule();

 private:
  void tick();
  void log_failure(const std::exception& exception) noexcept;

  Hub hub_;
  Context context_;  // Pending handlers end with the loop below and need the members above.
  asio::io_context io_;
  Turn turn_;
  Timer schedule_;
  std::optional<TimeUs> scheduled_us_;
  TimeUs pumped_us_ = 0;
  Timer tick_;
};

}  // namespace eigencast::broker
