// SPDX-License-Identifier: MIT
#pragma once

#include <sys/uio.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "broker/sockets/net.h"
#include "broker/sockets/transport.h"
#include "common/core/clock.h"
#include "common/core/fair_queue.h"
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
  /// The same for bytes given to Turn::send().
  virtual void sent(const Transport::Outcome& outcome) = 0;
  /// The same for all who share their turns with it.
  virtual const void* purse() const = 0;
  /// About how long flush() takes, or of writes in a batch the batch.
  virtual double write_us() const = 0;

 private:
  friend class Turn;
  enum class Queue : std::uint8_t { kNone, kNow, kTick, kLate };
  Queue queue_ = Queue::kNone;
  std::uint32_t slot_ = 0;
  std::uint64_t batch_ = 0;  ///< The last that had writes of it.
};

constexpr unsigned kMaxBatch = 1024;  ///< Writes that go to the kernel at a time.
constexpr std::size_t kBytesOfWrite = 24'000;  ///< As many bytes take as long as a short write.

/// Hands many writes to the kernel in one call. A batch holds at most kMaxBatch, one of each writer.
struct Uring;
/// Errors: kUnsupported (built without it, or the kernel refused).
Result<std::shared_ptr<Uring>> open_uring();
/// Adds the writer's bytes: see Turn::send().
void add_send(Uring& uring, SocketWriter& writer, int socket, ByteView bytes, bool tell);
/// Adds the writer's pieces. False: it has none.
bool add_pieces(Uring& uring, SocketWriter& writer, int socket);
/// Whether one more add_pieces() fits.
bool has_room(const Uring& uring);
/// Writes the batch. Throws if the kernel takes none of it, which is then still to be written.
void write_batch(Uring& uring);
/// Tells the writers what became of it.
void tell_writers(Uring& uring);

/// One turn of an event loop: the output of all ready handlers is written at its end, one write per connection. Under
/// load, output of connections with several streams waits for the next tick (see Gathering). Writes go through io_uring
/// in batches where the kernel has it, else one by one. What takes longer than a slice waits for slices of later turns,
/// holders in fair turns, so that others' input is read in between. Belongs to its event loop.
class Turn {
 public:
  struct Settings {
    Gathering::Settings gathering;
    bool uring = true;  ///< Where the kernel has it.
  };

  static constexpr double kSliceUs = 500;  ///< Of writes; of deliveries.

  /// Calls `deliver` at the end of each turn, before the writes. True: the next turn has to go on with it.
  Turn(asio::io_context& loop, const Settings& settings, LogSink log, std::function<bool()> deliver);
  Turn(const Turn&) = delete;

  /// Opens io_uring; on the loop's thread, before the loop runs.
  void begin();

  TimeUs now_us() { return now_us_ != 0 ? now_us_ : begin_turn(); }
  void arm() { (void)now_us(); }  ///< So that one ends.

  /// Whether one may write before the turn ends: most do, but for what takes longer, or is behind what is late.
  bool writes_at_once() const { return at_once_ < kAtOnce; }
  void note_written_at_once(std::size_t bytes) { at_once_ += kBytesOfWrite + bytes; }

  /// Whether writes join a batch, which is written when the turn ends or is full.
  bool batches() const { return ring_ != nullptr; }

  /// Adds bytes of a plain socket, kept by `owner`, to the batch. Calls sent() if they were not all written, or to
  /// `tell`. REQUIRES: batches(); !is_sending(writer).
  template <typename Owner>
  void send(SocketWriter& writer, int socket, ByteView bytes, const std::shared_ptr<Owner>& owner, bool tell) {
    if (batched_ == kMaxBatch) submit();
    if (held_last_ != owner.get()) hold(owner);
    writer.batch_ = batch_;
    ++batched_;
    add_send(*ring_.get(), writer, socket, bytes, tell);
  }
  /// Whether bytes of it are in the batch: nothing else may be written to its socket before submit().
  bool is_sending(const SocketWriter& writer) const { return writer.batch_ == batch_; }
  void submit();

  /// Flushes the writer at the end of this turn, or if it `may_wait` at the next tick.
  void add(SocketWriter& writer, bool may_wait);
  /// Whether it waits for a slice of a later turn.
  static bool is_late(const SocketWriter& writer) { return writer.queue_ == SocketWriter::Queue::kLate; }
  /// Removes the writer; call before its socket is closed.
  void forget(SocketWriter& writer);
  /// Whether `poses` due to a connection of several streams may wait for the next tick.
  bool gathers(std::uint64_t poses) { return gathering_.waits(poses, now_us()); }

 private:
  TimeUs begin_turn();
  void hold(std::shared_ptr<const void> owner);
  void arm_end();
  void end_turn();
  void arm_tick();
  std::vector<SocketWriter*>& list_of(SocketWriter::Queue queue) {
    return queue == SocketWriter::Queue::kNow ? now_ : queue == SocketWriter::Queue::kTick ? tick_ : late_writers_;
  }
  void flush_all(std::vector<SocketWriter*>& list);
  double flush_for(SocketWriter& writer);
  void flush(SocketWriter& writer);
  void put_off(SocketWriter& writer);
  void flush_slice();

  asio::io_context& loop_;
  LogSink log_;
  std::function<bool()> deliver_;
  const bool wants_uring_;
  Gathering gathering_;
  std::shared_ptr<Uring> ring_;
  std::vector<std::shared_ptr<const void>> held_;  ///< Owners of what the batch sends.
  const void* held_last_ = nullptr;                ///< The last of held_.
  std::uint64_t batch_ = 1;
  unsigned batched_ = 0;  ///< Writes in the batch.
  static constexpr std::size_t kAtOnce = kMaxBatch * kBytesOfWrite;
  std::size_t at_once_ = 0;  ///< Of this turn's writes before its end, in bytes.
  std::vector<SocketWriter*> now_;
  std::vector<SocketWriter*> tick_;
  std::vector<SocketWriter*> flushing_;  ///< Scratch.
  FairQueue<std::uint32_t, const void*> late_;
  std::vector<SocketWriter*> late_writers_;  ///< What late_ has places of; null: forgotten.
  std::vector<std::uint32_t> late_free_;     ///< Places that nobody has.
  Timer timer_;
  TimeUs now_us_ = 0;  ///< When the turn began; 0: none has.
  bool end_armed_ = false;
  bool tick_armed_ = false;
};

}  // namespace eigencast::broker
