// SPDX-License-Identifier: MIT
#pragma once

#include <sys/uio.h>

#include <cstdint>
#include <functional>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "broker/relay/gathering.h"
#include "broker/sockets/net.h"
#include "broker/sockets/transport.h"
#include "common/core/clock.h"
#include "common/core/log.h"

namespace eigencast::broker {

class Uring;

/// A connection with bytes to write.
class Writer {
 public:
  static constexpr std::size_t kMaxPieces = 128;

  virtual ~Writer() = default;
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

/// One turn of an event loop: the output of all ready handlers is written at its end, one write per connection. Under
/// load, output of connections with several streams waits for the next tick (see Gathering). Writes go through io_uring
/// in batches where the kernel has it, else one by one. Belongs to its event loop.
class Turn {
 public:
  struct Settings {
    Gathering::Settings gathering;
    enum class Backend : std::uint8_t { kAuto, kEpoll, kUring } backend = Backend::kAuto;
  };

  /// Calls `deliver` at the end of each turn, before the writes, and `prepare` after them.
  Turn(asio::io_context& loop, const Settings& settings, LogSink log, std::function<void()> deliver,
       std::function<void()> prepare);
  ~Turn();
  Turn(const Turn&) = delete;
  Turn& operator=(const Turn&) = delete;

  /// Opens io_uring; on the loop's thread, before the loop runs.
  void begin();
  const char* backend() const;

  /// The start time of this turn, for all its decisions.
  TimeUs now_us() { return now_us_ ? *now_us_ : begin_turn(); }

  /// Whether each write is a system call of its own, so that batching gains nothing.
  bool writes_singly() const { return !ring_; }

  /// Flushes the writer at the end of this turn, or if it `may_wait` at the next tick.
  void add(Writer& writer, bool may_wait);
  /// Removes the writer; call before it ends.
  void forget(Writer& writer);
  /// Whether `poses` due to a connection of several streams may wait for the next tick.
  bool gathers(std::uint64_t poses) { return gathering_.waits(poses, now_us()); }

 private:
  TimeUs begin_turn();
  void arm_end();
  void end_turn();
  void arm_tick();
  void enter(Writer& writer, Writer::Queue queue);
  std::vector<Writer*>& list_of(Writer::Queue queue) { return queue == Writer::Queue::kNow ? now_ : tick_; }
  void flush_all(std::vector<Writer*>& list);

  asio::io_context& loop_;
  LogSink log_;
  std::function<void()> deliver_, prepare_;
  Settings::Backend wanted_;
  Gathering gathering_;
  std::unique_ptr<Uring> ring_;
  std::vector<Writer*> now_;
  std::vector<Writer*> tick_;
  std::vector<Writer*> flushing_;  ///< Scratch.
  Timer timer_;
  std::optional<TimeUs> now_us_;
  bool end_armed_ = false;
  bool tick_armed_ = false;
};

}  // namespace eigencast::broker
