// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "broker/backbone/asset_exchange.h"
#include "broker/backbone/directory.h"
#include "broker/backbone/following.h"
#include "broker/backbone/link.h"
#include "broker/relay/hub.h"
#include "broker/relay/ownership.h"
#include "broker/relay/stream.h"
#include "common/core/log.h"

namespace eigencast::broker {

/// Connects several brokers: a stream sent to one of them is available at all.
///
/// The brokers share a directory: the owner, epoch and surface of each stream. A broker whose viewers watch a stream of
/// another one follows it (see Following). Interpolation and profiles run at the viewers' broker.
///
/// All actions follow from repeatedly comparing actual with wanted state (reconcile), so that no order of events, lost
/// message or broken link has lasting effects. Without a connection local streams continue and new ones are granted
/// locally; after a partition, of two senders of one stream the one with the later epoch stays.
///
/// Belongs to the event loop.
class Backbone final : public StreamTap, public Ownership, private Link::Listener {
 public:
  struct Settings {
    std::string id;                         ///< Unique id of this run.
    std::string prefix = "eigencast";       ///< Prefix of all subjects.
    TimeUs heartbeat_every_us = 1'000'000;  ///< Period of heartbeats (default: 1 s).
    TimeUs claim_timeout_us = 12'000'000;   ///< Without an answer of the table, claims are granted locally after this.
    TimeUs retry_us = 500'000;              ///< Delay of retries.
    TimeUs linger_us = 5'000'000;           ///< An unwatched stream is followed for this long.
  };
  struct Totals {
    bool connected = false;
    std::uint64_t brokers = 1, streams_known = 0, streams_followed = 0;
    std::uint64_t frames_published = 0, frames_followed = 0, frames_dropped = 0, joins_asked = 0, joins_answered = 0;
    std::uint64_t claims_refused = 0, senders_dismissed = 0, disconnects = 0, asset_bytes_fetched = 0;
  };
  struct Environment {
    std::function<TimeUs()> now_us;
    std::function<Result<std::uint32_t>(std::uint32_t above)> next_epoch;  ///< As EpochSource::next().
    std::function<bool()> replaces;     ///< Whether a second sender replaces the first instead of being refused.
    std::function<void()> frames_came;  ///< Called when streams have new frames.
    LogSink log;
  };

  /// link and assets outlive it.
  Backbone(Settings settings, Link& link, AssetExchange& assets, Environment environment);
  ~Backbone() override;

  /// Connects. REQUIRES: the hub outlives it, and this is among the taps of its streams.
  void start(Hub& hub);
  /// Announces the stop to the other brokers; no callbacks after it returns.
  void stop();
  /// Call at least ten times a second.
  void tick();

  void claim(const std::string& stream, const control::Announce& announce, Granted granted) override;

  void on_announced(const Stream& stream) override;
  void on_key(const Stream& stream, const KeyRecordPtr& record) override;
  void on_stalled(const Stream& stream) override;
  void on_forgotten(const Stream& stream) override;

  Totals totals() const;
  /// The number of connected brokers, or why there is no connection.
  std::string status() const;

 private:
  struct Claim {
    control::Announce announce;
    Granted granted;
    TimeUs since_us = 0;
  };
  /// A stream with a local sender.
  struct Own {
    DirectoryEntry entry;
    CoefficientLayout layout;
    KeyRecordPtr newest;
  };

  void on_connected() override;
  void on_disconnected(const std::string& why) override;
  void on_new_table() override;
  void on_row(const std::string& key, std::optional<std::string> text, std::uint64_t revision) override;
  void on_table_read() override;

  void reconcile();
  void reconcile_claims();
  void reconcile_own();
  void forget();
  void try_claim(const std::string& name);
  void grant(const std::string& name, Result<std::uint32_t> epoch);
  void write(const std::string& name, const std::optional<DirectoryEntry>& entry,
             std::function<void(const Result<std::uint64_t>&)> written = {});
  bool may_write(const std::string& name) const;
  void answer_join(ByteView request, const Link::Reply& reply);
  void send_heartbeat();
  void write_log(LogLevel level, const std::string& text) const;

  const Settings settings_;
  Link& link_;
  AssetExchange& assets_;
  const Environment environment_;
  Hub* hub_ = nullptr;
  Directory directory_;
  Following following_;
  bool connected_ = false, table_read_ = false, reconciling_ = false;
  std::string last_error_;
  std::map<std::string, Claim, std::less<>> claims_;
  std::map<std::string, Own, std::less<>> own_;
  std::map<std::string, TimeUs, std::less<>> writing_;  ///< Rows being written, or the time of their next try.
  std::vector<std::shared_ptr<void>> listening_;
  bool settled_ = false;  ///< The directory matches the local streams; reset by changes of either.
  TimeUs next_heartbeat_us_ = 0, next_forget_us_ = 0;
  Totals totals_;
};

}  // namespace eigencast::broker
