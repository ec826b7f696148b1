// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <boost/asio/io_context.hpp>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "broker/context/context.h"
#include "broker/relay/fair_reads.h"
#include "broker/relay/hub.h"
#include "broker/relay/mirror.h"
#include "broker/relay/moments.h"
#include "broker/relay/rooms.h"
#include "broker/sockets/loop_share.h"
#include "broker/sockets/turn.h"

namespace eigencast::broker {

/// One event loop with its streams, connections, writes and timers. Runs on one thread, chosen by its owner.
class Loop {
 public:
  struct Siblings {
    Loops& loops;
    std::shared_ptr<StreamIds> ids;
    std::shared_ptr<StreamMemory> memory;
    std::atomic<std::uint64_t>& last_connection_id;
    Rooms& rooms;
    Moments& moments;
  };

  Loop(const Config& config, const SharedContext& shared, const Siblings& siblings, std::vector<StreamTap*> taps,
       std::function<void(Stream&)> on_opened);

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

 private:
  FairReads reads_on(DiskThreads& threads);
  void arm_schedule();
  void tick();
  void tick_some();
  void arm_beat();
  void tell_some();
  /// Some of `those` after the id `last`, which is 0 once all are visited; the others in later turns, by `again`.
  void visit_some(std::uint64_t& last, const Connections& those, void (Connection::*visit)(), void (Loop::*again)());

  Hub hub_;
  FairReads memory_reads_, past_reads_;
  Context context_;  // Pending handlers end with the loop below and need the members above.
  asio::io_context io_;
  Turn turn_;
  LoopShare newcomers_, viewers_;
  Timer schedule_;
  std::optional<TimeUs> scheduled_us_;
  TimeUs pumped_us_ = 0;
  Timer tick_;
  Timer beat_;
  bool beat_armed_ = false;
  std::uint64_t ticked_ = 0, told_ = 0;
};

/// The event loops of a broker. The first one, which the owner runs, serves senders, HTTP and the admin port. The
/// others, each on its own thread, share the viewers with it and mirror the streams that these watch (relay/mirror.h).
/// Belongs to the first loop.
class Loops {
 public:
  /// Creates server.threads loops. `taps`: of the senders' streams.
  Loops(const Config& config, const SharedContext& shared, std::vector<StreamTap*> taps);
  ~Loops();

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
  void tick();  ///< Once a second.

 private:
  struct Other;
  void relay(std::function<void(Context&)> work, std::function<void()> done, std::size_t next);
  MirrorOrigin::Environment origin_environment();
  MirrorSet::Environment mirror_environment(std::size_t index);

  const std::shared_ptr<StreamIds> ids_;
  std::atomic<std::uint64_t> last_connection_id_{0};
  Rooms rooms_;
  Moments moments_;
  std::unique_ptr<MirrorOrigin> origin_;  ///< Null: there is one loop.
  std::unique_ptr<Loop> first_;
  std::vector<std::unique_ptr<Other>> others_;
};

}  // namespace eigencast::broker
