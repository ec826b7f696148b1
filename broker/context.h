// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <unordered_set>
#include <utility>
#include <vector>

#include <boost/asio/thread_pool.hpp>

#include "broker/access/gate.h"
#include "broker/config/config.h"
#include "broker/connections/transport.h"
#include "broker/connections/turn.h"
#include "broker/relay/hub.h"
#include "broker/relay/ownership.h"
#include "broker/storage/asset_store.h"
#include "broker/storage/recorder.h"
#include "common/core/log.h"

namespace eigencast::broker {

class Backbone;
class Connection;
class Loops;

/// Times in buckets, for /metrics: how many were at most so long. Belongs to the event loop.
struct LatencyBuckets {
  static constexpr std::array<TimeUs, 13> kUpTo{100,    250,    500,     1'000,   2'500,   5'000,    10'000,
                                                25'000, 50'000, 100'000, 250'000, 500'000, 1'000'000};
  void add(TimeUs us) {
    std::size_t bucket = 0;
    while (bucket < kUpTo.size() && us > kUpTo[bucket]) ++bucket;
    ++counts[bucket];
    sum_us += us;
  }
  LatencyBuckets& operator+=(const LatencyBuckets& other) {
    for (std::size_t i = 0; i < counts.size(); ++i) counts[i] += other.counts[i];
    sum_us += other.sum_us;
    return *this;
  }
  std::array<std::uint64_t, kUpTo.size() + 1> counts{};  ///< The last: longer than all.
  TimeUs sum_us = 0;
};

/// What happened so far, for /metrics. Owned by the event loop.
struct Counters {
  std::uint64_t connections_total = 0;
  std::uint64_t connections_refused = 0;
  std::uint64_t frames_received = 0;
  std::uint64_t frames_refused = 0;
  std::uint64_t frames_sent = 0;
  std::uint64_t frame_bytes_sent = 0;
  std::uint64_t frames_skipped = 0;
  std::uint64_t joins_sent = 0;
  std::uint64_t control_received = 0;
  std::uint64_t control_sent = 0;
  std::uint64_t slow_disconnects = 0;
  /// Steps of viewers' ladders, by the rung that they led to: see Ladder::Step.
  std::map<std::string, std::uint64_t> ladder_down;
  std::map<std::string, std::uint64_t> ladder_up;
  std::uint64_t kicked = 0;
  std::uint64_t senders_replaced = 0;
  LatencyBuckets latency;  ///< From when a pose was to leave (raw keys: came) to its first write.
  LatencyBuckets hold;     ///< From a key's coming to when its feed let it go: the price of interpolation.
  std::uint64_t uploads = 0;
  std::uint64_t uploads_failed = 0;
  std::uint64_t uploads_now = 0;
  std::uint64_t upload_bytes = 0;
  std::uint64_t downloads = 0;
  std::uint64_t downloads_now = 0;
  std::uint64_t download_bytes = 0;
};

/// One of those counted in `count`, while it lives.
class Seat {
 public:
  Seat() = default;
  explicit Seat(std::atomic<std::uint64_t>& count) : count_(&count) { ++count; }
  ~Seat() { leave(); }
  Seat(Seat&& other) noexcept : count_(std::exchange(other.count_, nullptr)) {}
  Seat& operator=(Seat&& other) noexcept {
    std::swap(count_, other.count_);
    return *this;
  }
  void leave() {
    if (auto* count = std::exchange(count_, nullptr)) --*count;
  }

 private:
  std::atomic<std::uint64_t>* count_ = nullptr;
};

/// What the connections of one event loop share. Built before them, destroyed after them; used on the loop's thread
/// only, except what is said to be of all loops, which is thread-safe.
struct Context {
  asio::io_context& loop;   ///< Of all loops: for posts.
  asio::thread_pool& disk;  ///< Of all loops. For calls that block on the disk.
  Config config;            ///< As of the latest reload.
  Gate& gate;               ///< Of all loops.
  Hub& hub;
  AssetStore& assets;        ///< Of all loops.
  Recorder& recorder;        ///< Of all loops.
  Ownership& ownership;      ///< Of the first loop.
  const Backbone* backbone;  ///< Of the first loop. Null: this broker stands alone.
  LogSink log;               ///< Of all loops.
  std::string version;
  std::string session_id;
  Turn& turn;    ///< What leaves at the end of each turn of the loop.
  Loops& loops;  ///< Of the first loop, which senders, HTTP and the admin port belong to.
  std::atomic<std::uint64_t>& last_connection_id;  ///< Of all loops.
  /// For all loops to read: connections of this one, those that are on their way to it too.
  std::atomic<std::uint64_t> open{0};
  Counters counters{};
  std::unordered_set<Connection*> connections{};  ///< WebSockets that are open.
  TimeUs started_us = 0;
  std::function<void()> drain{};  ///< Begins to stop, as SIGTERM does.
  bool draining = false;
  TlsProvider tls{};  ///< Gives null: the data port is plain.
  std::vector<std::uint8_t> read_buffer = std::vector<std::uint8_t>(64 * 1024);  ///< Of whoever reads just now.
};

}  // namespace eigencast::broker
