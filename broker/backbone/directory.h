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

/// What the brokers know of one stream in common: who has its sender, and what it is.
struct DirectoryEntry {
  std::string owner;           ///< The broker that has, or had last, the stream's sender.
  std::uint32_t epoch = 0;     ///< Grows with every announcement, whichever broker it came to.
  bool live = false;           ///< The sender is there.
  control::Announce announce;  ///< One per epoch and owner.
  bool operator==(const DirectoryEntry& other) const {
    return owner == other.owner && epoch == other.epoch && live == other.live;
  }
};

/// One JSON object.
std::string text_from_entry(const DirectoryEntry& entry);
/// Safe on hostile input. Errors: kCorrupt.
Result<DirectoryEntry> entry_from_text(std::string_view text);

/// The stream's name as a subject of NATS and as a key of its buckets: '/' separates tokens there, as '.' does, and the
/// '.' of a name becomes '=', which no name has.
std::string token_from_stream(std::string_view name);
/// Nothing where no stream has that token.
std::optional<std::string> stream_from_token(std::string_view token);

/// This broker's copy of what all brokers share: the entries of streams, as last told, with the revision that a change
/// must name; and which brokers have been heard of lately. Time comes in as an argument. Not thread-safe.
class Directory {
 public:
  /// Without a sign of life for so long a broker counts as gone, and its streams may be taken over.
  static constexpr TimeUs kSilenceUs = 5'000'000;
  /// Entries of brokers that are gone are removed after so long.
  static constexpr TimeUs kForgetUs = 600'000'000;
  /// Of brokers without streams about so many give a sign of life in each period, however many there are.
  static constexpr std::size_t kSpeakers = 100;
  static constexpr std::size_t kMaxBrokers = 200'000;  ///< More are not counted.

  struct Known {
    std::optional<DirectoryEntry> entry;  ///< Nothing: removed.
    std::uint64_t revision = 0;
  };

  /// self  this broker's id, different in every run
  Directory(std::string self, TimeUs now_us) : self_(std::move(self)), began_us_(now_us) {}

  /// A change that was told; `text` is empty where the entry was removed. Changes older than what is known are ignored.
  /// Errors: kCorrupt (the entry stays as it was).
  Result<void> take(std::string_view stream, std::optional<std::string_view> text, std::uint64_t revision);
  /// Nothing is known of streams any more: revisions count from the beginning.
  void begin_anew() { streams_.clear(); }
  /// A broker gave a sign of life.
  void heard(std::string_view broker, TimeUs now_us);
  /// Forgets brokers that have been silent for long: ids are new in every run, they will not come back.
  void forget_silent(TimeUs now_us);
  /// A broker said that it stops.
  void gone(std::string_view broker) { heard_us_.erase(std::string(broker)); }

  /// Whether the broker is there: itself always, others if heard of within kSilenceUs. Who has just begun to listen, or
  /// listens again, believes in everybody for so long.
  bool is_alive(std::string_view broker, TimeUs now_us) const;
  /// Listening begins anew, after the connection was lost.
  void listen_anew(TimeUs now_us) { began_us_ = now_us; }

  /// Null where nothing was ever told.
  const Known* find(std::string_view stream) const;
  /// The entry of a stream whose sender is at a broker that is there, this one included; null if there is none.
  const DirectoryEntry* live(std::string_view stream, TimeUs now_us) const;
  /// The revision that a change of the entry must name; 0: there never was one.
  std::uint64_t revision(std::string_view stream) const;
  /// Streams whose entries should be removed, because their brokers have been gone for long.
  std::vector<std::string> forgotten(TimeUs now_us) const;

  const std::string& self() const { return self_; }
  /// How many periods a broker without streams lets pass between two signs of life, so that a crowd of brokers is not
  /// busy with them: nobody asks whether such a broker is there.
  int pace() const { return static_cast<int>(std::max<std::size_t>(1, heard_us_.size() / kSpeakers)); }
  std::size_t brokers(TimeUs now_us) const;  ///< That are there, this one included; of many, as of pace() periods ago.
  const std::map<std::string, Known, std::less<>>& streams() const { return streams_; }

 private:
  std::string self_;
  TimeUs began_us_;
  std::map<std::string, Known, std::less<>> streams_;
  std::map<std::string, TimeUs, std::less<>> heard_us_;
};

/// Whether `mine`, an announcement that this broker granted while it could not ask, gives way to `other`, live at
/// another broker: the later epoch stays, and of equal ones the greater owner's.
bool gives_way(const DirectoryEntry& mine, const DirectoryEntry& other);

}  // namespace eigencast::broker
