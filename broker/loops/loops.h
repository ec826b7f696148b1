// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "broker/loops/loop.h"
#include "broker/relay/mirror.h"

namespace eigencast::broker {

/// The event loops of a broker. The first one, which the owner runs, serves senders, HTTP and the admin port. The others,
/// each on its own thread, share the viewers with it and mirror the streams that these watch (relay/mirror.h).
///
/// Belongs to the first loop.
class Loops {
 public:
  /// Creates server.threads loops. `taps`: of the senders' streams.
  Loops(const Config& config, const SharedContext& shared, std::vector<StreamTap*> taps);
  ~Loops();
  Loops(const Loops&) = delete;
  Loops& operator=(const Loops&) = delete;

  Loop& first() { return *first_; }
  const Loop& first() const { return *first_; }

  /// stop() returns when the other loops have ended.
  void start();
  void stop();

  /// The loop with the fewest connections, for a viewer that is now a connection of the first one.
  Context& least_busy();
  std::vector<std::uint64_t> connections() const;
  std::uint64_t connections_total() const;
  std::uint64_t connections_of_others() const;

  /// Runs `work` in one loop after the other, then `done` in the first. With one loop both have run when it returns.
  void for_each_loop(std::function<void(Context&)> work, std::function<void()> done);
  /// Once a second.
  void tick();

 private:
  struct Other;
  struct RelayTask {
    std::function<void(Context&)> work;
    std::function<void()> done;
  };
  void relay(std::shared_ptr<RelayTask> task, std::size_t next);
  std::unique_ptr<Loop> make_loop(const Config& config, const SharedContext& shared, std::vector<StreamTap*> taps,
                                  std::function<void(Stream&)> on_opened);
  MirrorOrigin::Environment origin_environment();
  MirrorSet::Environment mirror_environment(std::size_t index);

  const std::shared_ptr<StreamIds> ids_ = std::make_shared<StreamIds>();
  std::atomic<std::uint64_t> last_connection_id_{0};
  std::unique_ptr<MirrorOrigin> origin_;  ///< Null: there is one loop.
  std::unique_ptr<Loop> first_;
  std::vector<std::unique_ptr<Other>> others_;
};

}  // namespace eigencast::broker
