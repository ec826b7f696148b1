// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "broker/loop.h"
#include "broker/relay/mirror.h"

namespace eigencast::broker {

/// The event loops of a broker. The first, which its owner runs, has all that there is one of: senders and their
/// streams, HTTP, the admin port. The others, each on a thread of its own, share the viewers with it, and mirror the
/// streams that theirs watch (relay/mirror.h).
///
/// Belongs to the first loop, except what is said to be for any thread. With one loop nothing is posted to anybody.
class Loops {
 public:
  /// So many as server.threads says. `taps`: of the streams that have their senders here.
  Loops(const Config& config, const Loop::Common& common, std::vector<StreamTap*> taps);
  ~Loops();
  Loops(const Loops&) = delete;
  Loops& operator=(const Loops&) = delete;

  Loop& first() { return *first_; }
  const Loop& first() const { return *first_; }

  /// The others run until stop(), which returns when they have ended.
  void start();
  void stop();

  /// For a viewer, now a connection of the first loop: that of the loop with the fewest.
  Context& least_busy();
  /// Open connections of each loop.
  std::vector<std::uint64_t> connections() const;
  std::uint64_t connections_total() const;
  /// Of all loops but the first.
  std::uint64_t connections_elsewhere() const;

  /// Does `work` in each loop on its thread, one after the other, beginning with the first; then `done` in the first.
  /// With one loop both are done when it returns.
  void go_round(std::function<void(Context&)> work, std::function<void()> done);
  /// Once a second.
  void tick();

 private:
  struct Other;
  struct Slip {
    std::function<void(Context&)> work;
    std::function<void()> done;
  };
  void pass_on(std::shared_ptr<Slip> slip, std::size_t next);
  std::unique_ptr<Loop> make_loop(const Config& config, const Loop::Common& common, std::vector<StreamTap*> taps,
                                  std::function<void(Stream&)> on_opened);
  Mirrored::Surroundings around_mirrored();
  Mirrors::Surroundings around_mirrors(std::size_t index);

  const std::shared_ptr<StreamIds> ids_ = std::make_shared<StreamIds>();
  std::atomic<std::uint64_t> last_connection_id_{0};
  std::unique_ptr<Mirrored> mirrored_;  ///< Null: there is one loop.
  std::unique_ptr<Loop> first_;
  std::vector<std::unique_ptr<Other>> others_;
};

}  // namespace eigencast::broker
