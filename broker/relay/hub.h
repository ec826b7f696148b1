// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <unordered_map>
#include <utility>
#include <vector>

#include "broker/relay/stream.h"
#include "common/core/fair_queue.h"

namespace eigencast::broker {

/// All streams of an event loop by name. One without publisher and watchers is removed, unless it holds the last pose
/// of a sender of this broker: it stays until max_streams needs its slot. Belongs to its loop.
class Hub {
 public:
  struct Settings {
    std::size_t max_streams = 1024;  ///< Admitted ones (default: 1,024).
    Stream::Settings stream{};
    std::shared_ptr<StreamIds> ids = std::make_shared<StreamIds>();  ///< Shared by all hubs of a broker.
    std::function<void(Stream&)> on_opened = {};                     ///< Called for each new stream.
  };

  explicit Hub(const Settings& settings) : settings_(settings) {}

  /// Finds or creates the stream. REQUIRES: check_stream_name passed. Errors: those of StreamIds::of().
  Result<Stream*> open(std::string_view name, const Charge& charge = {}, const std::string& holder = {});
  /// Call before a sender of this broker announces: gives the stream one of max_streams and memory for its keys, at the
  /// cost of `holder`. At a limit streams without publisher and watchers make room. Strangers have a quarter less, in
  /// shares. Errors: kTooLarge (max_streams); those of `charge` and hold_keys().
  Result<void> admit(Stream& stream, const StreamHolder& holder, const StreamFormat& format, const Charge& charge);
  /// The same for memory alone: call before a sender of another broker announces. Errors: kTooLarge (max_bytes).
  Result<void> hold_keys(Stream& stream, const StreamHolder& holder, const StreamFormat& format);
  /// A sender's memory, read from its segments, becomes the stream's: continues the present one if there is one, whose
  /// segments then come first. Its poses are charged to who pays for its keys. Errors: kTooLarge (max_memory_bytes;
  /// PoseMemory).
  Result<void> remember(Stream& stream, std::vector<Generation::Segment> segments);
  /// For poses that others hold; `holder` pays. It may outlive the hub.
  PosesCharge poses_charge(const std::string& holder) const;
  Stream* find(std::string_view name);
  /// Call when a publisher or watcher has left `stream`. May destroy the stream.
  void unwatched(Stream& stream);
  /// A stream beside the named ones, under an id of its own and without taps, whose sender is not the network: the hub
  /// pumps it until forget_apart(). Its keys count towards `holder`. Errors: kTooLarge (max_bytes; no ids left).
  Result<std::unique_ptr<Stream>> make_apart(const std::string& name, const std::string& holder,
                                             const StreamFormat& format, TimeUs max_span_us);
  /// REQUIRES: no watchers. Call before it ends.
  void forget_apart(Stream& stream);
  /// Removes it with the pose it holds. REQUIRES: no publisher, no watchers.
  void drop(Stream& stream);

  /// Marks the streams that are due: deliver() makes their frames.
  void pump(TimeUs now_us);
  /// Marks a stream that took frames or watchers: deliver() sends its frames and reschedules it.
  void mark_dirty(Stream& stream) {
    if (dirty_.empty() || dirty_.back() != &stream) dirty_.push_back(&stream);
  }
  /// What takes longer than `slice_us`, by an estimate, waits for later calls, senders in fair turns. True: some does.
  bool deliver(double slice_us = std::numeric_limits<double>::infinity());
  std::optional<TimeUs> next_due_us() const;

  /// Sorted by name, at most so many of those after a name; valid until the next open() or unwatched().
  std::vector<const Stream*> streams(std::string_view after = {}, std::size_t most = SIZE_MAX) const;
  std::size_t size() const { return streams_.size(); }
  std::int64_t memory_bytes() const { return settings_.stream.memory->poses.used(); }  ///< Of all loops' streams.

 private:
  void deliver(Stream& stream);
  void schedule(Stream& stream);
  void unschedule(Stream& stream);
  void leave_queues(Stream& stream);
  bool make_room(const StreamHolder& holder, bool own);
  bool make_room_of_keys(const StreamHolder& holder, const std::string& payer, std::int64_t bytes);
  void discharge(Stream& stream);
  void forget(std::map<std::string, std::unique_ptr<Stream>, std::less<>>::iterator stream);

  Settings settings_;
  Shares strangers_;  ///< Their admitted streams.
  std::map<std::string, std::unique_ptr<Stream>, std::less<>> streams_;
  std::size_t admitted_ = 0;
  std::vector<Stream*> dirty_;
  FairQueue<std::uint32_t> late_;                          ///< Ids of dirty streams,
  std::unordered_map<std::uint32_t, Stream*> late_streams_;  ///< and those that are still there.
  std::set<std::pair<TimeUs, Stream*>> wakeups_;  ///< Streams by Stream::wake_us_.
};

}  // namespace eigencast::broker
