// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/core/clock.h"
#include "common/core/result.h"
#include "common/wire/control.h"

namespace eigencast::broker {

struct DirectoryEntry {
  std::string owner;           ///< The broker of the stream's present or last sender.
  std::uint32_t epoch = 0;     ///< Grows with every announcement at any broker.
  bool live = false;           ///< The sender is connected.
  control::Announce announce;  ///< One per epoch and owner.
  std::string resume = {};     ///< Likewise: Resume::issued. Empty: of an older broker.
  bool operator==(const DirectoryEntry& other) const {
    return owner == other.owner && epoch == other.epoch && live == other.live;
  }
};

/// One JSON object.
std::string text_from_entry(const DirectoryEntry& entry);
/// Safe on hostile input. Errors: kCorrupt.
Result<DirectoryEntry> entry_from_text(std::string_view text);

/// The stream's name as a NATS subject and bucket key: '/' becomes '.', '.' becomes '=', which names do not contain.
std::string token_from_stream(std::string_view name);
std::optional<std::string> stream_from_token(std::string_view token);

/// This broker's copy of the shared directory: entries of streams with their revisions, and the brokers' last
/// heartbeats. Not thread-safe.
class Directory {
 public:
  /// A broker without a heartbeat for this long counts as gone; its streams may be claimed by others.
  static constexpr TimeUs kHeartbeatTimeoutUs = 5'000'000;
  /// Entries of gone brokers are removed after this time.
  static constexpr TimeUs kForgetUs = 600'000'000;
  /// Target number of heartbeats per period from brokers without streams.
  static constexpr std::size_t kHeartbeatsPerPeriod = 100;
  static constexpr std::size_t kMaxBrokers = 200'000;  ///< More are ignored.

  struct Known {
    std::optional<DirectoryEntry> entry;  ///< Nothing: removed.
    std::uint64_t revision = 0;
  };

  /// self  this broker's id, unique per run
  Directory(std::string self, TimeUs now_us) : self_(std::move(self)), began_us_(now_us) {}

  /// No `text`: a removal. Ignores outdated revisions. Errors: kCorrupt (the entry is unchanged).
  Result<void> take(std::string_view stream, std::optional<std::string_view> text, std::uint64_t revision);
  /// The table's revisions start anew.
  void restart() { streams_.clear(); }
  void note_heartbeat(std::string_view broker, TimeUs now_us);
  /// Forgets brokers that have been silent for long; ids are not reused.
  void forget_silent(TimeUs now_us);
  void note_stopped(std::string_view broker) { last_heartbeat_us_.erase(std::string(broker)); }

  /// This broker always is, others are after a heartbeat within kHeartbeatTimeoutUs, and all that long after
  /// listening began.
  bool is_alive(std::string_view broker, TimeUs now_us) const;
  /// After a lost connection.
  void restart_listening(TimeUs now_us) { began_us_ = now_us; }

  const Known* find(std::string_view stream) const;
  /// The entry of a stream with a sender at a broker that is alive, this one included; else null.
  const DirectoryEntry* live(std::string_view stream, TimeUs now_us) const;
  /// The revision that a change of the entry must expect; 0: never written.
  std::uint64_t revision(std::string_view stream) const;
  /// Streams whose entries are to be removed because their brokers stopped long ago.
  std::vector<std::string> forgotten(TimeUs now_us) const;

  /// Periods between two heartbeats of a broker without streams; grows with their number, to bound the traffic.
  int heartbeat_periods() const {
    return static_cast<int>(std::max<std::size_t>(1, last_heartbeat_us_.size() / kHeartbeatsPerPeriod));
  }
  std::size_t brokers(TimeUs now_us) const;  ///< Alive ones, this one included.
  const std::map<std::string, Known, std::less<>>& streams() const { return streams_; }

 private:
  std::string self_;
  TimeUs began_us_;
  std::map<std::string, Known, std::less<>> streams_;
  std::map<std::string, TimeUs, std::less<>> last_heartbeat_us_;
};

/// Whether `mine`, granted locally during a partition, yields to the live entry `other` of another broker: the later
/// epoch stays, and of equal ones the greater owner's.
bool yields_to(const DirectoryEntry& mine, const DirectoryEntry& other);

}  // namespace eigencast::broker
