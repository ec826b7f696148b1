// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "broker/relay/stream.h"
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
  std::string sender = {};     ///< Likewise: sender_of().
  std::string next = {};       ///< The asset that the next epoch is to bring, in hexadecimal; empty: none is known.
  bool operator==(const DirectoryEntry&) const = default;
};

/// What a broker calls the token or address that sends a stream: a hash with its secret `salt`, so that no peer can try
/// all addresses.
std::string sender_of(const StreamHolder& holder, std::string_view salt);

/// Whose limits a stream of another broker counts towards here: its sender's, or all such of that broker's name.
std::string payer_of(const DirectoryEntry& entry);

/// One JSON object.
std::string text_from_entry(const DirectoryEntry& entry);
/// Safe on hostile input. Errors: kCorrupt.
Result<DirectoryEntry> entry_from_text(std::string_view text);

/// The stream's name as a NATS subject and bucket key: '/' becomes '.', '.' becomes '=', which names do not contain.
std::string token_from_stream(std::string_view name);
std::optional<std::string> stream_from_token(std::string_view token);

/// Whether it can be a broker's id, as a part of NATS subjects: NAME.RUN, at most 64 of letters, digits, '-' and '_'.
/// Permissions of NATS pin a broker to its name; each run of it has an id of its own.
bool is_broker_id(std::string_view id);
inline std::string_view name_of_broker(std::string_view id) {
  return id.substr(0, id.find('.'));
}

/// This broker's copy of the shared directory: entries of streams with their revisions, and the brokers' last
/// heartbeats. Its size is bounded, whatever other brokers say. Not thread-safe.
class Directory {
 public:
  /// A broker without a heartbeat for this long counts as gone; its streams may be claimed by others.
  static constexpr TimeUs kHeartbeatTimeoutUs = 5'000'000;
  /// Entries of gone brokers are removed after this time.
  static constexpr TimeUs kForgetUs = 600'000'000;
  static constexpr std::size_t kMaxForgotten = 50;  ///< At a time.
  /// Target number of heartbeats per period from brokers without streams.
  static constexpr std::size_t kHeartbeatsPerPeriod = 100;
  static constexpr std::size_t kMaxBrokers = 200'000;  ///< More are ignored.
  static constexpr std::size_t kMaxRuns = 256;         ///< Of a broker's name. Silent ones make room.
  /// More are ignored: streams of all brokers, and of one name of them. Those of gone brokers make room.
  static constexpr std::size_t kMaxStreams = 65'536, kMaxStreamsPerName = 16'384;

  struct Known {
    std::optional<DirectoryEntry> entry;  ///< Nothing: removed.
    std::uint64_t revision = 0;
    TimeUs since_us = 0;        ///< Of its last change.
    std::uint64_t reading = 0;  ///< Of the table, in which it was last heard of.
  };

  /// self  this broker's id, unique per run
  Directory(std::string self, TimeUs now_us) : self_(std::move(self)), began_us_(now_us) {}

  /// No `text`: a removal. `from`: the broker that says so; empty: the table. A broker speaks for itself, or removes
  /// what a gone one owned. Ignores outdated revisions. Errors (the entry is unchanged): kCorrupt, kRefused (it speaks
  /// for another one), kTooLarge (too many streams).
  Result<void> take(std::string_view stream, std::optional<std::string_view> text, std::uint64_t revision,
                    TimeUs now_us, std::string_view from = {});
  /// All rows of the table have been taken: what was not among them since the last call is void.
  void end_reading();
  /// The table holds no trace of a removed entry, or another revision.
  void drop_removed(std::string_view stream);
  /// The table's revisions start anew.
  void restart();
  void note_heartbeat(std::string_view broker, TimeUs now_us);
  /// Forgets brokers that have been silent for long; ids are not reused.
  void forget_silent(TimeUs now_us);
  void note_stopped(std::string_view broker);

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
  /// Streams whose entries are to be removed next: their brokers stopped long ago, or they ended here.
  std::vector<std::string> forgotten(TimeUs now_us) const;

  /// Periods between two heartbeats of a broker without streams; grows with their number, to bound the traffic.
  int heartbeat_periods() const {
    return static_cast<int>(std::max<std::size_t>(1, last_heartbeat_us_.size() / kHeartbeatsPerPeriod));
  }
  /// Of any run of the broker's name.
  bool has_streams(std::string_view broker) const { return streams_of_.contains(name_of_broker(broker)); }
  std::size_t brokers(TimeUs now_us) const;  ///< Alive ones, this one included.
  const std::map<std::string, Known, std::less<>>& streams() const { return streams_; }

 private:
  using Streams = std::map<std::string, Known, std::less<>>;
  bool has_room(bool is_new, const std::optional<DirectoryEntry>& entry, std::string_view owner_before, TimeUs now_us);
  void set(Known& known, std::optional<DirectoryEntry> entry);
  Streams::iterator erase(Streams::iterator found);

  std::string self_;
  TimeUs began_us_, next_room_us_ = 0;
  std::uint64_t reading_ = 1;
  Streams streams_;
  std::map<std::string, std::size_t, std::less<>> streams_of_;  ///< By name of their brokers.
  std::map<std::string, TimeUs, std::less<>> last_heartbeat_us_;
};

/// Whether `mine`, granted locally during a partition, yields to the live entry `other` of another broker: the later
/// epoch stays, and of equal ones the greater owner's.
bool yields_to(const DirectoryEntry& mine, const DirectoryEntry& other);

}  // namespace eigencast::broker
