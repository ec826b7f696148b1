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

#include "broker/connections/net.h"
#include "broker/connections/transport.h"
#include "broker/relay/gathering.h"
#include "common/core/clock.h"
#include "common/core/log.h"

namespace eigencast::broker {

class Uring;

/// Something with bytes to write: a connection, as Turn and Uring see it.
class Leaver {
 public:
  static constexpr std::size_t kMaxPieces = 128;

  virtual ~Leaver() = default;
  /// Writes what is due, and deals with the outcome.
  virtual void leave() = 0;
  /// For those who write for it: its socket, or -1 if only leave() will do (TLS).
  virtual int plain_socket() = 0;
  /// For those who write for it: fills in what is due, returns how many pieces that is. They stay until left().
  virtual std::size_t pieces(std::span<iovec> out) = 0;
  /// For those who write for it: what became of it.
  virtual void left(const Transport::Outcome& outcome) = 0;

 private:
  friend class Turn;
  enum class Line : std::uint8_t { kNone, kNow, kTick };
  Line line_ = Line::kNone;
  std::uint32_t place_ = 0;
};

/// One turn of an event loop: what the handlers that were ready owe to all connections leaves at its end, each
/// connection's in one write. Under load, what is owed to connections of several streams waits for the next tick
/// (see Gathering). The writes go through io_uring in batches where the kernel has it, else one by one. Belongs to its
/// event loop.
class Turn {
 public:
  struct Settings {
    Gathering::Settings gathering;
    enum class Backend : std::uint8_t { kAuto, kEpoll, kUring } backend = Backend::kAuto;
  };

  /// `deliver` is called at the end of each turn that began(), before what it adds leaves, and `prepare` after that.
  Turn(asio::io_context& loop, const Settings& settings, LogSink log, std::function<void()> deliver,
       std::function<void()> prepare);
  ~Turn();
  Turn(const Turn&) = delete;
  Turn& operator=(const Turn&) = delete;

  /// Takes what the kernel offers; on the thread that runs the loop, before it runs.
  void begin();
  /// "io_uring" or "epoll".
  const char* backend() const;

  /// The time at which this turn began, for all its decisions.
  TimeUs now_us() { return now_us_ ? *now_us_ : begin_turn(); }

  /// Whether each write is a system call of its own: waiting for others gains nothing then.
  bool writes_singly() const { return !ring_; }

  /// The connection leaves at the end of this turn; `may_wait`: or at the next tick.
  void add(Leaver& leaver, bool may_wait);
  /// It has nothing to write any more; call before it ends.
  void forget(Leaver& leaver);
  /// Whether `poses` that a connection of several streams is owed now may wait for the next tick.
  bool gathers(std::uint64_t poses) { return gathering_.waits(poses, now_us()); }

 private:
  TimeUs begin_turn();
  void arm_end();
  void end_turn();
  void arm_tick();
  void enter(Leaver& leaver, Leaver::Line line);
  std::vector<Leaver*>& list_of(Leaver::Line line) { return line == Leaver::Line::kNow ? now_ : tick_; }
  void leave_all(std::vector<Leaver*>& list);

  asio::io_context& loop_;
  LogSink log_;
  std::function<void()> deliver_, prepare_;
  Settings::Backend wanted_;
  Gathering gathering_;
  std::unique_ptr<Uring> ring_;
  std::vector<Leaver*> now_;
  std::vector<Leaver*> tick_;
  std::vector<Leaver*> leaving_;  ///< Scratch.
  Timer timer_;
  std::optional<TimeUs> now_us_;
  bool end_armed_ = false;
  bool tick_armed_ = false;
};

}  // namespace eigencast::broker
