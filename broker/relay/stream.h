// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "broker/relay/feed.h"
#include "broker/relay/shares.h"
#include "broker/relay/stream_ids.h"
#include "broker/relay/tracer.h"
#include "common/wire/control.h"

namespace eigencast::broker {

class Stream;

/// A viewer of a stream. Its callbacks must not add or remove watchers.
class Watcher {
 public:
  virtual ~Watcher() = default;
  /// Whose share of a stream's places and of memory it takes (see Shares).
  virtual std::string holder() const { return {}; }
  /// Counts what encoding poses for it took; false: its holder's budget for that is used up. 0: asks.
  virtual bool charge_poses(double /*work_us*/) { return true; }
  /// Takes what a key in its profile costs, apart; false: the budget is used up, and the key is left out.
  virtual bool take_key(double /*work_us*/) { return true; }
  /// Takes what coding a key anew took from the same budget, whatever is left of it.
  virtual void charge_key(double /*work_us*/) {}
  virtual const void* purse() const { return this; }  ///< The same for all of a holder.
  /// The stream's state or format changed. `restart`: later frames build on none of the earlier ones.
  virtual void on_stream_changed(const Stream& stream, bool restart) = 0;
  /// The stream has another memory().
  virtual void on_memory(const Stream& /*stream*/) {}
  /// Later frames build on none of the earlier ones, as with `restart`.
  virtual void on_restart(const Stream& /*stream*/) {}
  virtual void on_frames(const Stream& stream, std::span<const FramePtr> frames) = 0;
  virtual void on_trace(const std::shared_ptr<const std::string>& text) = 0;
};

/// The sender of a stream.
class PublisherLink {
 public:
  virtual ~PublisherLink() = default;
  virtual void on_watcher_count(std::uint32_t count) = 0;
  virtual void on_trace_wanted() {}
  /// Another sender has claimed the stream. Must not touch the stream.
  virtual void on_replaced() {}
  /// Whether it yields to any sender that claims the stream.
  virtual bool yields() const { return false; }
};

/// Observes the input of streams: recorder, asset store, backbone, mirrors. Called on the stream's event loop, in
/// order; must return at once and must not change the stream.
class StreamTap {
 public:
  virtual ~StreamTap() = default;
  virtual void on_announced(const Stream& stream) = 0;
  virtual void on_key(const Stream& stream, const KeyRecordPtr& record) = 0;
  virtual void on_stalled(const Stream& stream) = 0;
  /// The number of its watchers in all loops has changed, or its publisher has gone.
  virtual void on_demand_changed(const Stream& /*stream*/) {}
  virtual void on_trace(const Stream& /*stream*/, const control::Trace& /*trace*/) {}
  virtual void on_memory(const Stream& /*stream*/) {}
  virtual void on_next(const Stream& /*stream*/) {}
  virtual void on_forgotten(const Stream& stream) = 0;
};

/// What the streams of a broker hold, in bytes, by estimates from their formats. Thread-safe.
struct StreamMemory {
  Shares keys;     ///< Of their senders: keys_bytes().
  Shares encoded;  ///< Of who asked for the profile first: encoded_bytes().
  Shares poses;    ///< That streams remember, of their senders.
};

/// The segment, which somebody pays for as long as it is there. Thread-safe. Errors: kTooLarge.
using PosesCharge =
    std::function<Result<std::shared_ptr<const MemorySegment>>(std::shared_ptr<const MemorySegment> segment)>;

/// Who sends a stream.
struct StreamHolder {
  std::string key;
  bool stranger = false;  ///< Without a token, from elsewhere: displaces poses of strangers only.
  bool spared = false;    ///< May have more than its share.
};

using NextPtr = std::shared_ptr<const control::StreamInfo::Next>;

/// The state of a stream from which another event loop can continue.
struct Snapshot {
  control::Announce announced;
  std::uint32_t epoch = 0;  ///< 0: never announced.
  bool live = false;        ///< The sender is there.
  KeyRecordPtr newest;      ///< Null: no key of this epoch yet.
  std::uint8_t tag = 0;     ///< Stands for the epoch in frames.
  GenerationPtr memory{};   ///< Null: none.
  std::uint32_t used = 0;   ///< The newest generation that a key needed; 0: none since the memory's root.
  NextPtr next{};           ///< Null: no other epoch is being prepared.
};
using SnapshotPtr = std::shared_ptr<const Snapshot>;

/// One stream: its publisher, its key chain, and a feed per watched profile. It and its watchers belong to one event
/// loop; each loop that watches a stream has its own Stream (see mirror.h), and these share a StreamShare.
class Stream {
 public:
  static constexpr double kOfferUs = 0.035;  ///< What a sender pays for a key and a viewer.

  struct Settings {
    TimeUs max_span_us = 500'000;         ///< Keys further apart are not bridged by interpolation (default: 500 ms).
    std::uint32_t max_watchers = 10'000;  ///< More are refused (default: 10,000).
    std::size_t max_profiles = 64;        ///< The budget of profiles that are not common (default: 64).
    std::vector<StreamTap*> taps{};       ///< Each outlives the stream (default: none).
    TimeUs max_ahead_us = 200'000;        ///< Estimates end this long after the newest key (default: 200 ms).
    std::int64_t max_bytes = Shares::kUnlimited;         ///< Of memory->keys, and of memory->encoded.
    std::int64_t max_memory_bytes = Shares::kUnlimited;  ///< Of memory->poses.
    std::shared_ptr<StreamMemory> memory = std::make_shared<StreamMemory>();  ///< Of all hubs of a broker.
    /// How long viewers have to fetch the next asset: kMostPrepareUs at most, and this at least, as viewers at other
    /// brokers are not counted.
    TimeUs min_prepare_us = 0;
  };
  static constexpr TimeUs kMostPrepareUs = 30'000'000;

  Stream(std::string name, std::uint32_t id, const Settings& settings)
      : Stream(std::move(name), std::make_shared<StreamShare>(id), settings) {}
  Stream(std::string name, std::shared_ptr<StreamShare> share, const Settings& settings);
  ~Stream();

  /// Makes `link` the publisher; replaces the present one if that yields or `replace` is set. Errors: kRefused.
  Result<void> claim(PublisherLink& link, bool replace = false);
  /// The publisher disconnected: the stream stalls and holds its last pose. Ignored from any other link.
  void release(PublisherLink& link);

  /// Begins an epoch, or continues the present one from its next join. REQUIRES: the format passed check_format,
  /// epochs do not fall. Errors: kInvalidArgument (codec).
  Result<void> announce(const control::Announce& announce, std::uint32_t epoch, const std::string& resume = {});
  /// Resume::issued of the last announcement; a later claim does not change it.
  const std::string& resume() const { return resume_; }

  /// Shows viewers what the next epoch is to bring, an asset of which none holds; null: nothing any more.
  void prepare(NextPtr next);
  /// The same for mirrors of a stream of another loop.
  void set_next(NextPtr next);
  /// Whether viewers hold the next asset, or have had the time, `waited_us` after prepare(). See StreamShare.
  bool is_prepared(TimeUs waited_us) const;
  /// The epoch that continues the present one, from the first frame with the tag returned, a join. REQUIRES: as
  /// announce(), and the present epoch is of this publisher. Errors: as announce().
  Result<std::uint8_t> announce_next(const control::Announce& announce, std::uint32_t epoch, const std::string& resume);

  /// Takes a binary message of the publisher and delivers the frames that follow from it. Ignores the envelope's stream
  /// id. Errors, without a change: kCorrupt, kTooLarge, kUnsupported (see docs/protocol.md).
  Result<void> add_frame(ByteView message, TimeUs now_us);
  /// The same, but delivery waits for deliver(), so that a watcher gets the frames of several messages in one call.
  Result<void> take_frame(ByteView message, TimeUs now_us);
  /// The same for a frame of any tag.
  Result<void> take_frame(const WireFrame& frame, TimeUs now_us);
  void deliver();
  /// About how long deliver() takes, or pump() where it is due.
  double delivery_us() const;

  /// Replaces what keys may be predicted from; null: nothing. Where the one before is not continued its state in the
  /// chain is void, on the sender's side, too. REQUIRES: of layout().
  void set_memory(GenerationPtr memory);
  const GenerationPtr& memory() const { return present_.memory; }
  /// The newest key as one that needs no memory; where all keys do not, as it came. Null before the first. It follows
  /// the one that was returned for the key before. Adds about how long coding it took, if it was not coded before, to
  /// `work_us`, or to what take_unpaid_us() returns.
  const KeyRecordPtr& plain(double* work_us = nullptr) const;
  /// What its sender made it do besides decoding, since the last call: keys for each viewer, traces, changes of chains,
  /// keys coded anew.
  double take_unpaid_us() { return std::exchange(unpaid_us_, 0); }
  /// What its keys took in profiles since the last call, which viewers pay for.
  double take_profiles_us() { return std::exchange(profiles_us_, 0); }
  /// About how long it takes to tell each viewer something of the stream, so that it maybe begins anew.
  double telling_us() const;

  // For mirrors of a stream of another loop.

  /// New watchers get no on_stream_changed() until restore().
  void await_snapshot() { awaits_snapshot_ = true; }
  /// Continues from the other stream's snapshot. REQUIRES: as announce(). Errors: as announce().
  Result<void> restore(const Snapshot& snapshot);
  void take_record(const KeyRecordPtr& record, TimeUs now_us);
  void stall();

  // For the stream that is mirrored.

  const Snapshot& snapshot() const { return present_; }
  /// The hub keeps it while `mirrored`; call Hub::unwatched() after resetting it.
  void set_mirrored(bool mirrored) { mirrored_ = mirrored; }
  bool is_mirrored() const { return mirrored_; }
  /// Acts as trace_every(), for its mirrors' watchers.
  void set_mirror_trace(std::uint32_t every);
  void report_count();

  /// Adds a watcher, or changes its profile. Beyond the budget, or its share of memory, it gets the nearest_profile();
  /// info_for() has what it gets. Calls on_stream_changed. Errors: kTooLarge (watchers), kInvalidArgument.
  Result<void> watch(Watcher& watcher, const Profile& profile);
  /// Serves a watcher what it asked for, or nearer, if the budget has come to allow it. Call now and then. Returns
  /// whether anything changed.
  bool improve(Watcher& watcher);
  void unwatch(Watcher& watcher);
  /// A watcher has the poses of a generation: it gets keys that need them from a join on.
  void note_held(Watcher& watcher, std::uint32_t generation);
  /// A watcher has all of an asset.
  void note_prepared(const Watcher& watcher, const std::string& asset);

  void pump(TimeUs now_us);
  std::optional<TimeUs> next_due_us() const;

  /// Requests traces of every n-th key for a watcher; 0: none. Ignored for others. False: its holder has its share of
  /// those who are told of traces.
  bool trace(Watcher& watcher, std::uint32_t every);
  /// The interval at which the sender is to trace keys: the least that any watcher wants; 0: none.
  std::uint32_t trace_every() const { return shorter_interval(tracer_.every(), mirror_trace_); }
  void relay_trace(const control::Trace& trace);

  /// Null before the first key. Adds about how long encoding it took, if it was not encoded before, to `work_us`.
  FramePtr join_for(const Watcher& watcher, double* work_us = nullptr);
  /// About how long a part of a frame of its sender takes to decode, by its bytes; the coefficients count for the last.
  double decoding_us(std::uint64_t bytes, bool last) const;
  control::StreamInfo info_for(const Watcher& watcher) const;
  Profile profile_of(const Watcher& watcher) const;
  /// Reports to watchers that what comes from the next epoch on is of the past.
  void set_rewind(const control::StreamInfo::Rewind& rewind) { rewind_ = rewind; }
  /// The same as a message: one for all of a profile, as a stream may have many watchers and long names.
  std::shared_ptr<const std::string> info_text(const Watcher& watcher) const;
  /// `remember`, likewise, for viewers that were told of so many of the segments. REQUIRES: memory().
  std::shared_ptr<const std::string> memory_text(std::size_t kept) const;

  const std::string& name() const { return name_; }
  std::uint32_t id() const { return share_->id; }
  const std::shared_ptr<StreamShare>& share() const { return share_; }
  std::uint32_t epoch() const { return present_.epoch; }
  std::uint8_t tag() const { return present_.tag; }
  const std::string& asset() const { return present_.announced.asset; }
  const control::Announce& announcement() const { return present_.announced; }
  const CoefficientLayout& layout() const { return layout_; }
  double key_rate_hz() const { return present_.announced.key_rate_hz; }
  control::StreamInfo::State state() const;
  /// watchers(): in all loops; watchers_here(): in this one.
  std::uint32_t watchers() const { return static_cast<std::uint32_t>(share_->watchers.used()); }
  std::uint32_t watchers_here() const { return static_cast<std::uint32_t>(watched_.size()); }
  bool has_publisher() const { return publisher_ != nullptr; }
  const StreamHolder& holder() const { return holder_; }  ///< Without key: of no sender here.
  /// Whose limits it counts towards: the holder's, or those of its sender at another broker.
  const std::string& payer() const { return holder_.key.empty() ? keys_.payer : holder_.key; }
  std::uint64_t keys_received() const { return keys_received_; }
  std::uint64_t frames_made() const { return frames_made_; }
  /// Poses that no feed could encode.
  std::uint64_t poses_failed() const { return poses_failed_; }
  /// 0 while nothing is announced.
  std::uint8_t bands() const { return static_cast<std::uint8_t>(layout_.band_ends.size()); }
  std::size_t profile_count() const { return groups_.size(); }

 private:
  friend class Hub;
  struct Group {
    Group(const Profile& profile, bool is_plain, const Feed::Source& source)
        : feed(profile, source, [this](double work_us) { return charge_poses(work_us); }), plain(is_plain) {}
    bool charge_poses(double work_us);
    /// The stream's newest key, if somebody pays for it. Else it, or a newer one, is tried again, and its receivers get
    /// a join.
    void add_key(const Stream& stream, TimeUs now_us);
    /// Goes on to the first who does, if one of the next kMaxPayersAsked holders does.
    template <typename Pays>
    bool find_payer(Pays pays);
    void remove(const Watcher& watcher);
    Feed feed;
    const bool plain;  ///< Of those who lack the memory that keys need.
    std::vector<Watcher*> watchers;
    std::size_t payer = 0;             ///< Who of them pays for poses while it can.
    std::optional<TimeUs> retry_us{};  ///< When the newest key, which nobody paid for, is tried again.
    std::vector<FramePtr> pending;     ///< Made, waiting for deliver().
    std::vector<FramePtr> traced;      ///< Sent frames whose traces are due.
    std::shared_ptr<void> memory;
  };

  struct Keys {  ///< What is counted for them, set by the hub.
    std::string payer;
    std::int64_t bytes = 0;
    std::shared_ptr<void> memory;
  };

  struct Watched {
    Profile wanted;                   ///< Made canonical().
    Group* group = nullptr;           ///< Null before the first epoch.
    std::shared_ptr<void> place;      ///< Among the stream's watchers.
    std::uint32_t generation = 0;     ///< Of the memory that it has.
    std::uint32_t came_to = 0;        ///< Of the one that was there when it came.
    bool prepared = false;            ///< It holds the next asset.
    std::shared_ptr<void> tracing{};  ///< Of traced_.
  };
  struct Coming {
    Snapshot snapshot;
    std::string resume;
  };
  using GroupKey = std::pair<Profile, bool>;  ///< Profile, plain.

  Profile effective(const Profile& wanted) const;
  Profile affordable(const Watched& watched, const Watcher& watcher) const;
  /// Whether it has no memory that keys need.
  bool needs_plain(const Watched& watched) const { return watched.generation < present_.used; }
  /// former  its feed in the epoch that is continued; may be null
  void join_group(Watcher& watcher, Watched& watched, const Feed* former = nullptr);
  /// Moves it where needs_plain() says.
  void change_chain(Watcher& watcher, bool sender_pays);
  void leave_group(const Watcher& watcher, Watched& watched);
  std::shared_ptr<void> forget(const Watcher& watcher);
  void deliver(Group& group);
  void send_traces(Group& group);
  Result<KeyRecordPtr> record_from(const FrameView& frame, TimeUs now_us) const;

  std::string name_;
  std::shared_ptr<StreamShare> share_;
  Settings settings_;
  PublisherLink* publisher_ = nullptr;
  Snapshot present_;
  bool awaits_snapshot_ = false;
  bool mirrored_ = false;
  std::uint32_t mirror_trace_ = 0;
  CoefficientLayout layout_;
  Shares traced_;  ///< Of those who are told of traces.
  std::unordered_map<const Watcher*, Watched> watched_;
  std::map<GroupKey, std::unique_ptr<Group>> groups_;
  mutable KeyRecordPtr plain_;  ///< See plain(); null: it begins anew.
  mutable double unpaid_us_ = 0;
  mutable double profiles_us_ = 0;
  std::vector<Watcher*> order_;                                               ///< All watchers, in order of arrival.
  mutable std::map<Profile, std::shared_ptr<const std::string>> info_texts_;  ///< Of present_.
  mutable std::map<std::size_t, std::shared_ptr<const std::string>> memory_texts_;  ///< Likewise, by `kept`.
  bool has_pending_ = false;                                                        ///< In any group.
  std::optional<TimeUs> wake_us_;  ///< Set by the hub: when it is pumped next.
  std::optional<TimeUs> due_us_;   ///< Set by the hub: until when its frames are to be made.
  std::shared_ptr<void> charge_;   ///< Set by the hub once admitted, with holder_.
  StreamHolder holder_;
  Keys keys_;
  std::string resume_;
  std::optional<Coming> coming_;  ///< Announced; its first frame has not come.
  std::optional<control::StreamInfo::Rewind> rewind_;
  Tracer tracer_;
  std::uint64_t keys_received_ = 0;
  std::uint64_t frames_made_ = 0;
  std::uint64_t poses_failed_ = 0;
};

}  // namespace eigencast::broker
