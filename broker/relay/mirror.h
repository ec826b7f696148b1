// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <variant>
#include <vector>

#include "broker/relay/hub.h"

/// One stream in several event loops. Its sender, its key chain and its taps are in the first one: the origin. Each
/// loop where somebody watches it has a mirror of it, with the feeds that its own viewers use. What crosses is
/// immutable and shared, in batches, in order. No sockets, no clock, no threads: how batches travel, the owner says.
namespace eigencast::broker {

/// What happened to a stream at its origin.
struct MirrorEvent {
  struct Stalled {};
  using TracePtr = std::shared_ptr<const control::Trace>;
  using ErrorPtr = std::shared_ptr<const Error>;
  std::uint32_t stream_id = 0;
  /// Where it stands (the answer to kFollow, and each announcement), its next key, its sender's end, a sender's trace,
  /// or why it cannot be had.
  std::variant<StandingPtr, KeyRecordPtr, Stalled, TracePtr, ErrorPtr> what;
};
using MirrorEvents = std::vector<MirrorEvent>;

/// What a mirror says to the origin.
struct MirrorAsk {
  enum class Kind : std::uint8_t { kFollow, kLetGo, kChanged };
  Kind kind = Kind::kFollow;
  std::string stream;
  std::uint32_t stream_id = 0;    ///< To be answered to.
  std::uint32_t trace_every = 0;  ///< kChanged: what is wanted now. How many watch, StreamShare says.
};
using MirrorAsks = std::vector<MirrorAsk>;

/// At the loop of the senders: tells the other loops what becomes of the streams that they follow. A tap of its
/// streams.
///
/// A loop that has kMostUnderWay events before it gets no more; when it has dealt with them, it goes on from where the
/// streams stand then.
class Mirrored final : public StreamTap {
 public:
  static constexpr std::uint64_t kMostUnderWay = 16'384;

  struct Surroundings {
    std::function<void(std::size_t loop, MirrorEvents)> send;
    std::function<std::uint64_t(std::size_t loop)> taken;  ///< So many events has that loop dealt with so far.
    std::function<void()> flush_soon;                      ///< Call flush() at the end of this turn.
  };

  /// `loops`: that mirror; they are named 0, 1 ...
  Mirrored(std::size_t loops, Surroundings surroundings);

  /// `loop` asks; the hub is that of all calls.
  void take(Hub& hub, std::size_t loop, const MirrorAsks& asks);
  /// Sends what waits. Call once a second too: who had fallen behind goes on then.
  void flush();

  // StreamTap
  void on_announced(const Stream& stream) override;
  void on_key(const Stream& stream, const KeyRecordPtr& record) override;
  void on_stalled(const Stream& stream) override;
  void on_trace(const Stream& stream, const control::Trace& trace) override;
  void on_forgotten(const Stream&) override {}  // Not while it is mirrored.

 private:
  struct Way {
    MirrorEvents waiting;
    std::uint64_t sent = 0;
    bool behind = false;
  };
  struct Followed {
    Stream* stream = nullptr;
    std::map<std::size_t, std::uint32_t> trace_every;  ///< Of each loop that follows it.
  };

  void follow(Hub& hub, std::size_t loop, const MirrorAsk& ask);
  void let_go(Hub& hub, std::size_t loop, Followed& followed);
  /// How many watch, and what is wanted traced.
  static void tell_sender(const Followed& followed);
  void tell_all(const Stream& stream, const MirrorEvent& event);
  void push(std::size_t loop, MirrorEvent event);
  void catch_up(std::size_t loop);
  void arm();

  const Surroundings surroundings_;
  std::vector<Way> ways_;
  std::map<std::string, Followed, std::less<>> followed_;  ///< By name: of an id, an ask may be behind.
  bool armed_ = false;
};

/// At another loop: makes each stream of its hub a mirror, and lets it go when nobody watches it there.
class Mirrors {
 public:
  struct Surroundings {
    std::function<void(MirrorAsks)> ask;
    std::function<void()> settle_soon;  ///< Call settle() at the end of this turn.
  };

  explicit Mirrors(Surroundings surroundings);
  ~Mirrors();
  Mirrors(const Mirrors&) = delete;
  Mirrors& operator=(const Mirrors&) = delete;

  /// Of the hub (Hub::Settings::on_opened).
  void on_opened(Stream& stream);
  /// What comes from the origin. The hub owes the streams what follows from it.
  void take(Hub& hub, const MirrorEvents& events, TimeUs now_us);
  void settle(Hub& hub);

 private:
  class Mirror;
  void change(Mirror& mirror);
  void ask(MirrorAsk::Kind kind, const Stream& stream);

  const Surroundings surroundings_;
  std::map<std::uint32_t, std::unique_ptr<Mirror>> mirrors_;  ///< By stream id.
  std::vector<std::uint32_t> changed_;
  MirrorAsks asks_;
  bool armed_ = false;
};

}  // namespace eigencast::broker
