// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "broker/backbone/asset_exchange.h"
#include "broker/backbone/directory.h"
#include "broker/backbone/following.h"
#include "broker/backbone/link.h"
#include "broker/backbone/peer_work.h"
#include "broker/backbone/remote_memory.h"
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
  using Settings = BackboneSettings;
  using Totals = BackboneTotals;
  using Environment = BackboneEnvironment;

  /// link and assets outlive it.
  Backbone(Settings settings, Link& link, AssetExchange& assets, Environment environment);
  ~Backbone() override { stop(); }

  /// Connects. REQUIRES: the hub outlives it, and this is among the taps of its streams.
  void start(Hub& hub);
  /// Announces the stop to the other brokers; no callbacks after it returns.
  void stop();
  /// Call at least ten times a second.
  void tick();

  void claim(const std::string& stream, const control::Announce& announce, const Resume& resume,
             Granted granted) override;

  Result<std::uint32_t> next_epoch(const std::string& stream) override;
  void on_announced(const Stream& stream) override;
  void on_key(const Stream& stream, const KeyRecordPtr& record) override;
  void on_stalled(const Stream& stream) override;
  void on_memory(const Stream& stream) override;
  void on_next(const Stream& stream) override;
  void on_demand_changed(const Stream& stream) override { following_.note(stream.name()); }
  void on_forgotten(const Stream& stream) override;

  Totals totals() const;
  /// The number of connected brokers, or why there is no connection.
  std::string status() const;

 private:
  struct Claim {
    std::uint64_t number = 0;  ///< What was written of an earlier one does not grant it.
    control::Announce announce;
    Resume resume;
    Granted granted;
    TimeUs since_us = 0;
  };
  /// A stream with a local sender.
  struct Own {
    DirectoryEntry entry;
    CoefficientLayout layout;
    std::string frames;  ///< Their subject.
    KeyRecordPtr newest;
    Bytes join;               ///< At `newest`, once a broker has asked for it.
    MemoryNotice memory{};    ///< As other brokers were told.
    bool wants_join = false;  ///< One of them has it, and wants the sender's chain to begin.
  };

  void on_connected() override;
  void on_disconnected(const std::string& why) override;
  void on_new_table() override;
  void on_row(const std::string& key, std::optional<std::string> text, std::uint64_t revision,
              const std::string& from) override;
  void on_table_read() override;

  void reconcile();
  void reconcile_claims();
  void reconcile_own(const std::string& name);
  void note(const std::string& name);
  void forget();
  std::uint32_t epochs_before(const std::string& name) const;
  void try_claim(const std::string& name);
  Result<std::uint32_t> epoch_apart(std::uint32_t above) const;
  void grant(const std::string& name, Result<std::uint32_t> epoch);
  void write(const std::string& name, const std::optional<DirectoryEntry>& entry,
             std::function<void(const Result<std::uint64_t>&)> written = {});
  bool may_write(const std::string& name) const;
  void answer_join(ByteView request, const Link::Reply& reply);
  void publish_recalled(Own& own, const Stream& stream, const KeyRecord& record);
  void send_heartbeat(char text);
  void tell_rows();

  const Settings settings_;
  const std::string salt_;  ///< Of sender_of(); no other broker knows it.
  Link& link_;
  AssetExchange& assets_;
  const Environment environment_;
  Hub* hub_ = nullptr;
  Directory directory_;
  PeerWork work_;
  Totals totals_;
  Following following_;
  bool connected_ = false, table_read_ = false, reconciling_ = false;
  std::string last_error_;
  std::map<std::string, Claim, std::less<>> claims_;
  std::uint64_t last_claim_ = 0;
  std::map<std::string, Own, std::less<>> own_;
  std::map<std::string, TimeUs, std::less<>> writing_;  ///< Rows being written, or the time of their next try.
  std::vector<std::shared_ptr<void>> listening_;
  std::set<std::string> unsettled_;  ///< Names whose rows may not match the local streams.
  bool rows_asked_ = false;          ///< By a broker that cannot read the table.
  TimeUs next_heartbeat_us_ = 0, next_forget_us_ = 0, next_rows_us_ = 0;
};

}  // namespace eigencast::broker
