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
#include "broker/relay/stream_tap.h"
#include "common/core/log.h"

namespace eigencast::broker {

/// Several brokers as one: a stream whose sender is at one of them is seen at all.
///
/// The brokers share a directory (which broker has a stream's sender, its epoch and surface). A broker whose viewers
/// want a stream of another one follows it: it copies the surface's objects into its own store, takes key frames from
/// the backbone as if they came from a sender of its own, and begins with a join that it asks the owner for.
/// Interpolation, profiles and everything else happen where the viewers are.
///
/// What it does follows from comparing what is with what should be, again and again (reconcile): no order of events,
/// lost message or broken link leaves it astray. Without a connection local streams go on, and new ones are granted
/// locally; when brokers meet again, of two senders of one stream the one of the later epoch stays.
///
/// No sockets. Not thread-safe: belongs to the event loop.
class Backbone final : public StreamTap, public Ownership, private Link::Listener {
 public:
  struct Settings {
    std::string id;                        ///< Of this run of this broker.
    std::string prefix = "eigencast";      ///< Of all subjects.
    TimeUs alive_every_us = 1'000'000;     ///< Signs of life (default: 1 s).
    TimeUs claim_timeout_us = 12'000'000;  ///< A table that does not answer for so long is done without.
    TimeUs retry_us = 500'000;             ///< Until the next try of what failed.
    TimeUs linger_us = 5'000'000;          ///< A stream that nobody here watches any more is followed so much longer.
  };
  struct Totals {
    bool connected = false;
    std::uint64_t brokers = 1, streams_known = 0, streams_followed = 0;
    std::uint64_t frames_published = 0, frames_followed = 0, frames_dropped = 0, joins_asked = 0, joins_answered = 0;
    std::uint64_t claims_refused = 0, senders_dismissed = 0, disconnects = 0, asset_bytes_fetched = 0;
  };
  /// What it needs of its surroundings.
  struct Surroundings {
    std::function<TimeUs()> now_us;
    std::function<Result<std::uint32_t>(std::uint32_t above)> next_epoch;  ///< As EpochSource::next().
    std::function<bool()> replaces;     ///< A second sender takes a stream over, instead of being refused.
    std::function<void()> frames_came;  ///< Streams have frames that are due.
    LogSink log;
  };

  /// link and assets outlive it.
  Backbone(Settings settings, Link& link, AssetExchange& assets, Surroundings surroundings);
  ~Backbone() override;

  /// Connects. REQUIRES: the hub outlives it, and this is among the taps of its streams.
  void start(Hub& hub);
  /// Tells the other brokers that this one goes; nothing happens any more when it returns.
  void stop();
  /// Call some ten times a second.
  void tick();

  // Ownership
  void claim(const std::string& stream, const control::Announce& announce, Granted granted) override;

  // StreamTap
  void on_announced(const Stream& stream) override;
  void on_key(const Stream& stream, const KeyRecordPtr& record) override;
  void on_stalled(const Stream& stream) override;
  void on_forgotten(const Stream& stream) override;

  Totals totals() const;
  /// One line for people: connected to how many brokers, or why not.
  std::string status() const;

 private:
  /// An announcement that waits for the directory to agree.
  struct Claim {
    control::Announce announce;
    Granted granted;
    TimeUs since_us = 0;
  };
  /// A stream whose sender is here.
  struct Own {
    DirectoryEntry entry;
    CoefficientLayout layout;
    KeyRecordPtr newest;
  };

  // Link::Listener
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
  void answer_join(ByteView question, const Link::Reply& reply);
  void sign_of_life();
  void say(LogLevel level, const std::string& text) const;

  const Settings settings_;
  Link& link_;
  AssetExchange& assets_;
  const Surroundings surroundings_;
  Hub* hub_ = nullptr;
  Directory directory_;
  Following following_;
  bool connected_ = false, table_read_ = false, reconciling_ = false;
  std::string trouble_;
  std::map<std::string, Claim, std::less<>> claims_;
  std::map<std::string, Own, std::less<>> own_;
  std::map<std::string, TimeUs, std::less<>> writing_;  ///< Rows that are being written, or may be tried again then.
  std::vector<std::shared_ptr<void>> listening_;
  bool settled_ = false;  ///< Own streams are in the directory as they are: nothing to do until one of both changes.
  TimeUs next_alive_us_ = 0, next_forget_us_ = 0;
  Totals totals_;
};

}  // namespace eigencast::broker
