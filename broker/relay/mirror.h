// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "broker/relay/hub.h"

/// One stream in several event loops. Its sender, key chain and taps belong to the first loop, the origin. Each other
/// loop with viewers has a mirror with the feeds of its own viewers. Events between loops are immutable, shared,
/// batched and ordered; the owner transports the batches.
namespace eigencast::broker {

struct MirrorEvent {
  struct Stalled {};
  using TracePtr = std::shared_ptr<const control::Trace>;
  std::shared_ptr<StreamShare> share;  ///< Keeps the stream's id from being used again meanwhile.
  /// SnapshotPtr: the answer to kFollow, and each announcement.
  /// GenerationPtr: the memory, or none any more. NextPtr: likewise what the next epoch is to bring.
  std::variant<SnapshotPtr, KeyRecordPtr, Stalled, TracePtr, GenerationPtr, NextPtr> what;
};
using MirrorEvents = std::vector<MirrorEvent>;
/// 1, and 1 for each 4 KiB that its key takes.
std::uint64_t cost_of(const MirrorEvent& event);

struct MirrorRequest {
  enum class Kind : std::uint8_t { kFollow, kRelease, kChanged };
  Kind kind = Kind::kFollow;
  std::string stream;
  std::uint32_t stream_id = 0;    ///< For the answer.
  std::uint32_t trace_every = 0;  ///< kChanged: the wanted interval. StreamShare has the watchers.
};
using MirrorRequests = std::vector<MirrorRequest>;

/// In the senders' loop: sends the events of followed streams to the other loops. A loop with unprocessed events that
/// cost kMaxInFlight gets no more; once it has processed them, it continues from a snapshot.
class MirrorOrigin final : public StreamTap {
 public:
  static constexpr std::uint64_t kMaxInFlight = 16'384;

  struct Environment {
    std::function<void(std::size_t loop, MirrorEvents)> send;
    std::function<std::uint64_t(std::size_t loop)> taken;  ///< The cost of what the loop has processed so far.
    std::function<void()> flush_soon;                      ///< Call flush() at the end of this turn.
  };

  MirrorOrigin(std::size_t loops, Environment environment);

  /// The hub is the same in all calls.
  void take(Hub& hub, std::size_t loop, const MirrorRequests& requests);
  /// Call once a second too, so that loops that were behind continue.
  void flush();

  void on_announced(const Stream& stream) override;
  void on_key(const Stream& stream, const KeyRecordPtr& record) override;
  void on_stalled(const Stream& stream) override;
  void on_trace(const Stream& stream, const control::Trace& trace) override;
  void on_memory(const Stream& stream) override;
  void on_next(const Stream& stream) override;
  void on_forgotten(const Stream&) override {}  // Never while mirrored.

 private:
  struct Channel {
    MirrorEvents waiting;
    std::uint64_t sent = 0;
    bool behind = false;
  };
  struct Followed {
    Stream* stream = nullptr;
    std::map<std::size_t, std::uint32_t> trace_every;  ///< By following loop.
  };

  void follow(Hub& hub, std::size_t loop, const MirrorRequest& request);
  void release_stream(Hub& hub, std::size_t loop, Followed& followed);
  static void notify_sender(const Followed& followed);
  void broadcast(const Stream& stream, const MirrorEvent& event);
  void push(std::size_t loop, MirrorEvent event);
  void catch_up(std::size_t loop);
  void arm() {
    if (!std::exchange(armed_, true)) environment_.flush_soon();
  }

  const Environment environment_;
  std::vector<Channel> channels_;
  std::map<std::string, Followed, std::less<>> followed_;  ///< By name: ids in requests may be outdated.
  bool armed_ = false;
};

/// In another loop: makes each stream of its hub a mirror, and releases it when it has no watchers.
class MirrorSet {
 public:
  struct Environment {
    std::function<void(MirrorRequests)> request;
    std::function<void()> flush_soon;  ///< Call flush() at the end of this turn.
  };

  explicit MirrorSet(Environment environment);
  ~MirrorSet();

  void on_opened(Stream& stream);
  void take(Hub& hub, const MirrorEvents& events, TimeUs now_us);
  void flush(Hub& hub);

 private:
  class Mirror;
  void change(Mirror& mirror);
  void request(MirrorRequest::Kind kind, const Stream& stream);

  const Environment environment_;
  std::map<std::uint32_t, std::unique_ptr<Mirror>> mirrors_;  ///< By stream id.
  std::vector<std::uint32_t> changed_;
  MirrorRequests requests_;
  bool armed_ = false;
};

}  // namespace eigencast::broker
