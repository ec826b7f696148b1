// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/core/clock.h"

namespace eigencast::broker {

/// Latencies in buckets, for /metrics. Belongs to the event loop.
struct LatencyBuckets {
  static constexpr std::array<TimeUs, 13> kUpTo{100,    250,    500,     1'000,   2'500,   5'000,    10'000,
                                                25'000, 50'000, 100'000, 250'000, 500'000, 1'000'000};
  void add(TimeUs us) {
    ++counts[std::lower_bound(kUpTo.begin(), kUpTo.end(), us) - kUpTo.begin()];
    sum_us += us;
  }
  LatencyBuckets& operator+=(const LatencyBuckets& other) {
    for (std::size_t i = 0; i < counts.size(); ++i) counts[i] += other.counts[i];
    sum_us += other.sum_us;
    return *this;
  }
  std::array<std::uint64_t, kUpTo.size() + 1> counts{};  ///< The last counts those above every bound.
  TimeUs sum_us = 0;
};

struct EventCounts {
  std::uint64_t connections_total = 0;
  std::uint64_t connections_refused = 0;
  std::uint64_t frames_received = 0;
  std::uint64_t frame_bytes_received = 0;
  std::uint64_t frames_refused = 0;
  std::uint64_t frames_sent = 0;
  std::uint64_t frame_bytes_sent = 0;
  std::uint64_t frames_dropped = 0;
  std::uint64_t joins_sent = 0;
  std::uint64_t control_received = 0;
  std::uint64_t control_sent = 0;
  std::uint64_t slow_disconnects = 0;
  std::uint64_t kicked = 0;
  std::uint64_t reloads = 0;
  std::uint64_t reloads_failed = 0;
  std::uint64_t senders_replaced = 0;
  std::uint64_t memories = 0;
  std::uint64_t memories_refused = 0;
  std::uint64_t keys_recalled = 0;
  std::uint64_t recalled_bytes = 0;  ///< Of frame_bytes_received, those of keys_recalled.
  std::uint64_t uploads = 0;
  std::uint64_t uploads_failed = 0;
  std::uint64_t uploads_now = 0;
  std::uint64_t answers_now = 0;  ///< Being sent, over HTTP.
  std::uint64_t upload_bytes = 0;
  std::uint64_t downloads = 0;
  std::uint64_t downloads_now = 0;
  std::uint64_t download_bytes = 0;
};

struct Counters : EventCounts {
  /// Steps of viewers' ladders, by the rung they led to (Ladder::Step).
  std::map<std::string, std::uint64_t> ladder_down;
  std::map<std::string, std::uint64_t> ladder_up;
  LatencyBuckets latency;  ///< From a pose's due time (raw keys: arrival) to its first write.
  LatencyBuckets hold;     ///< From a key's arrival to its emission: the delay that interpolation costs.
};

/// What the admin API reports about one WebSocket.
struct ClientInfo {
  enum class Kind : std::uint8_t { kSender, kViewer };
  Kind kind = Kind::kViewer;
  std::uint64_t id = 0;
  std::string who;  ///< Token's subject and address; not secret.
  TimeUs connected_us = 0;
  struct Watched {
    std::string stream;
    std::string profile;   ///< In use; empty: it is the sender.
    std::size_t rung = 0;  ///< Steps of the ladder below the requested profile.
  };
  static constexpr std::size_t kMaxStreams = 8;
  std::vector<Watched> streams;         ///< The first kMaxStreams
  std::size_t stream_count = 0;         ///< of these.
  std::optional<TimeUs> round_trip_us;  ///< Least recent time from a frame to its acknowledgement.
  bool acknowledges = false;
  std::uint64_t frames_sent = 0;
  std::uint64_t bytes_sent = 0;
  std::uint64_t dropped = 0;
  std::uint64_t joins = 0;
  std::uint64_t control_waiting = 0;
};

struct Uncount {
  void operator()(std::atomic<std::uint64_t>* count) const { --*count; }
};
/// Counts one connection while it lives.
using ConnectionCount = std::unique_ptr<std::atomic<std::uint64_t>, Uncount>;
inline ConnectionCount counted_in(std::atomic<std::uint64_t>& count) {
  ++count;
  return ConnectionCount(&count);
}

}  // namespace eigencast::broker
