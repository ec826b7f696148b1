// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "broker/backbone/asset_exchange.h"
#include "broker/backbone/directory.h"
#include "broker/backbone/link.h"
#include "broker/backbone/peer_work.h"
#include "broker/backbone/remote_memory.h"
#include "broker/relay/hub.h"
#include "broker/relay/fair_reads.h"
#include "common/core/log.h"

namespace eigencast::broker {

struct BackboneSettings {
  std::string id;                         ///< Unique id of this run.
  std::string prefix = "eigencast";       ///< Prefix of all subjects.
  TimeUs heartbeat_every_us = 1'000'000;  ///< Period of heartbeats (default: 1 s).
  TimeUs claim_timeout_us = 12'000'000;   ///< Without an answer of the table, claims are granted locally after this.
  TimeUs retry_us = 500'000;              ///< Delay of retries.
  TimeUs linger_us = 5'000'000;           ///< An unwatched stream is followed for this long.
  TimeUs sweep_us = 1'000'000;            ///< Period of comparing all names: time alone changes some.
};
struct BackboneTotals {
  bool connected = false;
  std::uint64_t brokers = 1, streams_known = 0, streams_subscribed = 0;
  std::uint64_t frames_published = 0, frames_followed = 0, frames_dropped = 0, joins_asked = 0, joins_answered = 0,
                joins_encoded = 0;
  std::uint64_t claims_refused = 0, senders_evicted = 0, disconnects = 0, asset_bytes_fetched = 0;
  std::uint64_t names_compared = 0;  ///< Wanted with actual state.
};
struct BackboneEnvironment {
  std::function<TimeUs()> now_us;
  std::function<Result<std::uint32_t>(std::uint32_t above)> next_epoch;  ///< As EpochSource::next().
  std::function<void(std::uint32_t seen)> note_epoch;                    ///< As EpochSource::note().
  std::function<bool()> replaces;   ///< Whether a second sender replaces the first instead of being refused.
  std::function<bool()> remembers;  ///< Whether streams may have a memory here.
  std::function<bool(const std::string& holder, FairReads::Read)> read_memory;  ///< As FairReads::push().
  std::function<void()> frames_came;  ///< Called when streams have new frames.
  LogSink log;

  void inform(const LogLine& line) const { say(LogLevel::kInfo, line); }
  void warn(const LogLine& line) const { say(LogLevel::kWarning, line); }
  void say(LogLevel level, const LogLine& line) const {
    eigencast::log(log, level, {"backbone: " + std::string(line.text), line.file.data(), line.number});
  }
};

/// The streams of other brokers that local viewers watch; a part of Backbone.
///
/// Acts as the sender of each: copies its surface, subscribes to its frames, and requests a join from its owner at the
/// start and after each gap. Takes keys that need no memory until it holds the stream's, then those of the sender, and
/// again the former after whatever goes wrong. Belongs to the event loop.
class Following {
 public:
  /// All of them outlive it.
  Following(const BackboneSettings* settings, Link& link, AssetExchange& assets, const BackboneEnvironment* environment,
            Directory& directory, PeerWork& work, BackboneTotals& totals)
      : settings_(*settings),
        link_(link),
        assets_(assets),
        environment_(*environment),
        directory_(directory),
        work_(work),
        totals_(totals) {}
  ~Following();

  /// REQUIRES: the hub lives until stop().
  void start(Hub& hub) { hub_ = &hub; }
  void stop();

  /// Feeds `stream` from the broker of `entry`, replacing its publisher.
  void follow(Stream& stream, const DirectoryEntry& entry);
  bool feeds(std::string_view name) const;
  void forget_stream(std::string_view name);

  /// Call when a stream's watchers or sender here, or its entry in the directory, have changed; note_all(): when any
  /// may have.
  void note(std::string_view name) { changed_.emplace(name); }
  void note_all() { next_sweep_us_ = 0; }
  /// Time has passed: what is unfinished is compared again. Not for each row, as much may be unfinished.
  void tick() { changed_.merge(later_); }

  /// Follows remote streams that are watched here and no others. `complete`: absent entries of the directory count.
  /// Compares what was noted, and all names once in sweep_us.
  void reconcile(bool connected, bool complete);

  std::size_t size() const { return remotes_.size(); }

 private:
  struct Remote;
  using RemotePtr = std::shared_ptr<Remote>;

  std::vector<std::string> take_changed();
  bool is_over(Remote& remote, bool complete) const;
  const DirectoryEntry* wanted_entry(const Stream& stream) const;
  void unfollow(const std::string& name);
  void advance(const RemotePtr& remote);
  void fetch_surface(const RemotePtr& remote);
  void fetch_next(const RemotePtr& remote);
  /// Whether viewers may be told of a change now; else its stream is compared again later.
  bool may_tell(const Remote& remote);
  void begin(const RemotePtr& remote);
  void ask_join(const RemotePtr& remote);
  void take(const RemotePtr& remote, Bytes message, bool recalled);
  std::string frames_of(const DirectoryEntry& entry, const std::string& stream) const;
  void take_plain_frames(const RemotePtr& remote);
  void ask_memory(const RemotePtr& remote);
  void take_memory(const RemotePtr& remote, ByteView message);
  void note_memory(const RemotePtr& remote, MemoryNotice notice);
  void fetch_segments(const RemotePtr& remote, std::size_t first);
  void load_memory(const RemotePtr& remote);
  void remember(const RemotePtr& remote, std::vector<Generation::Segment> segments, const Result<void>& loaded);
  void retry_memory(Remote& remote, const Error& why);

  const BackboneSettings& settings_;
  Link& link_;
  AssetExchange& assets_;
  const BackboneEnvironment& environment_;
  Directory& directory_;
  PeerWork& work_;
  BackboneTotals& totals_;
  Hub* hub_ = nullptr;
  std::map<std::string, RemotePtr, std::less<>> remotes_;
  std::set<std::string, std::less<>> changed_, later_;
  TimeUs next_sweep_us_ = 0;
};

}  // namespace eigencast::broker
