// SPDX-License-Identifier: MIT
#pragma once

#include <sys/uio.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "broker/sockets/net.h"
#include "broker/sockets/transport.h"
#include "common/core/clock.h"
#include "common/core/log.h"
#include "common/core/result.h"

namespace eigencast::broker {

/// Decides whether poses for connections that watch several streams wait for the next tick, so that one write carries
/// the poses of all streams. They wait under load only. The load measure, poses due to such connections, does not
/// depend on the decision, so that it does not oscillate. Not thread-safe.
class Gathering {
 public:
  struct Settings {
    TimeUs tick_us = 8'000;                   ///< Longest delay; the mean is half of it. 0: never gather.
    std::uint64_t above_per_second = 20'000;  ///< Poses; gathering ends below half of it.
  };

  explicit Gathering(const Settings& settings) : settings_(settings) {}

  /// `poses` are due to a connection of several streams. True: they may wait.
  bool waits(std::uint64_t poses, TimeUs now_us);
  TimeUs next_tick_us(TimeUs now_us) const { return (now_us / settings_.tick_us + 1) * settings_.tick_us; }

 private:
  Settings settings_;
  TimeUs period_start_us_ = 0;
  std::uint64_t poses_ = 0;
  bool waits_ = false;
};

/// The unsent output of a connection, which its Turn flushes. None of the functions may throw.
class SocketWriter {
 public:
  static constexpr std::size_t kMaxPieces = 128;

  virtual ~SocketWriter() = default;
  virtual void flush() = 0;
  // For batched writes.
  /// Its socket, or -1 if only flush() works (TLS).
  virtual int plain_socket() = 0;
  /// Fills in the queued pieces and returns their number. They stay valid until written().
  virtual std::size_t pieces(std::span<iovec> out) = 0;
  virtual void written(const Transport::Outcome& outcome) = 0;

 private:
  friend class Turn;
  enum class Queue : std::uint8_t { kNone, kNow, kTick };
  Queue queue_ = Queue::kNone;
  std::uint32_t slot_ = 0;
};

struct Uring;
/// Serves many connections with few system calls. Errors: kUnsupported (built without it, or the kernel refused).
Result<std::shared_ptr<Uring>> open_uring();
/// Flushes all writers, those with a plain socket in batches that are complete when the call returns.
void write_all(Uring& ring, std::span<SocketWriter* const> writers);

/// One turn of an event loop: the output of all ready handlers is written at its end, one write per connection. Under
/// load, output of connections with several streams waits for the next tick (see Gathering). Writes go through io_uring
/// in batches where the kernel has it, else one by one. Belongs to its event loop.
class Turn {
 public:
  struct Settings {
    Gathering::Settings gathering;
    bool uring = true;  ///< Where the kernel has it.
  };

  /// Calls `deliver` at the end of each turn, before the writes, and `prepare` after them.
  Turn(asio::io_context& loop, const Settings& settings, LogSink log, std::function<void()> deliver,
       std::function<void()> prepare);
  Turn(const Turn&) = delete;

  /// Opens io_uring; on the loop's thread, before the loop runs.
  void begin();
  const char* backend() const { return ring_ ? "io_uring" : "epoll"; }

  TimeUs now_us() { return now_us_ ? *now_us_ : begin_turn(); }

  /// Whether each write is a system call of its own, so that batching gains nothing.
  bool writes_singly() const { return !ring_; }

  /// Flushes the writer at the end of this turn, or if it `may_wait` at the next tick.
  void add(SocketWriter& writer, bool may_wait);
  /// Removes the writer; call before it ends.
  void forget(SocketWriter& writer);
  /// Whether `poses` due to a connection of several streams may wait for the next tick.
  bool gathers(std::uint64_t poses) { return gathering_.waits(poses, now_us()); }

 private:
  TimeUs begin_turn();
  void arm_end();
  void end_turn();
  void arm_tick();
  std::vector<SocketWriter*>& list_of(SocketWriter::Queue queue) {
    return queue == SocketWriter::Queue::kNow ? now_ : tick_;
  }
  void flush_all(std::vector<SocketWriter*>& list);

  asio::io_context& loop_;
  LogSink log_;
  std::function<void()> deliver_, prepare_;
  const bool wants_uring_;
  Gathering gathering_;
  std::shared_ptr<Uring> ring_;
  std::vector<SocketWriter*> now_;
  std::vector<SocketWriter*> tick_;
  std::vector<SocketWriter*> flushing_;  ///< Scratch.
  Timer timer_;
  std::optional<TimeUs> now_us_;
  bool end_armed_ = false;
  bool tick_armed_ = false;
};

}  // namespace eigencast::broker
