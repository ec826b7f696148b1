// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <unordered_map>
#include <vector>

#include "broker/relay/feed.h"
#include "broker/relay/stream_ids.h"
#include "broker/relay/stream_tap.h"
#include "broker/relay/tracer.h"
#include "common/wire/control.h"

namespace eigencast::broker {

class Stream;

/// Somebody who watches a stream. Must not subscribe or unsubscribe anybody while it is being called.
class Watcher {
 public:
  virtual ~Watcher() = default;
  /// What the stream is from now on. `restart`: frames to come build on none of those before.
  virtual void on_stream_changed(const Stream& stream, bool restart) = 0;
  virtual void on_frame(const Stream& stream, const FramePtr& frame) = 0;
  /// Several at once, in order.
  virtual void on_frames(const Stream& stream, std::span<const FramePtr> frames) {
    for (const FramePtr& frame : frames) on_frame(stream, frame);
  }
  /// `text`: framed.
  virtual void on_trace(const std::shared_ptr<const std::string>& text) = 0;
  /// The stream cannot be had; it must stop watching within the call.
  virtual void on_dismissed(Stream& stream, const Error& why);
};

/// The sender of a stream, as the stream sees it.
class PublisherLink {
 public:
  virtual ~PublisherLink() = default;
  virtual void on_watcher_count(std::uint32_t count) = 0;
  /// Stream::trace_every() has changed.
  virtual void on_trace_wanted() {}
  /// It is no longer the sender: another one has claimed the stream. Must not touch the stream.
  virtual void on_replaced() {}
  /// Whether it makes way for whoever claims the stream.
  virtual bool yields() const { return false; }
};

/// Where a stream stands: all that another event loop needs to go on from there.
struct Standing {
  control::Announce announced;
  std::uint32_t epoch = 0;  ///< 0: nothing was ever announced.
  bool live = false;        ///< The sender is there.
  KeyRecordPtr newest;      ///< Null: no key of this epoch has come.
};
using StandingPtr = std::shared_ptr<const Standing>;

/// One stream: its publisher, its key chain, and a feed per profile that somebody watches.
///
/// Time comes in as an argument; no sockets. Not thread-safe: a stream and all who watch it belong to one event loop.
/// Where several loops watch a stream, each has one of its own (see mirror.h), and they share a StreamShare.
class Stream {
 public:
  struct Settings {
    TimeUs max_span_us = 500'000;         ///< Keys further apart are not bridged by interpolation (default: 500 ms).
    std::uint32_t max_watchers = 10'000;  ///< More are refused (default: 10,000).
    std::size_t max_profiles = 64;        ///< Different profiles watched at a time; more are refused (default: 64).
    std::vector<StreamTap*> taps{};       ///< Each outlives the stream (default: none).
    TimeUs max_ahead_us = 200'000;        ///< Estimates end so long after the newest key (default: 200 ms).
  };

  Stream(std::string name, std::uint32_t id, const Settings& settings)
      : Stream(std::move(name), std::make_shared<StreamShare>(id), settings) {}
  Stream(std::string name, std::shared_ptr<StreamShare> share, const Settings& settings);
  ~Stream();
  Stream(const Stream&) = delete;
  Stream& operator=(const Stream&) = delete;

  /// Makes `link` the publisher. Another one that is there is sent away if it yields or `replace`. Errors: kRefused
  /// otherwise.
  Result<void> claim(PublisherLink& link, bool replace = false);
  /// The publisher is gone: the stream stalls and its last pose is held. Ignored from anyone else.
  void release(PublisherLink& link);

  /// Begins an epoch, or goes on with the one it had from its next join on. REQUIRES: the format passed check_format,
  /// epochs do not fall. Errors: kInvalidArgument (codec).
  Result<void> announce(const control::Announce& announce, std::uint32_t epoch);

  /// Takes a binary message of the publisher and delivers what follows from it. The envelope's stream id and epoch are
  /// not read: the connection and its last announcement say them. Errors: kCorrupt, kTooLarge, kUnsupported (see
  /// docs/protocol.md); nothing has changed then.
  Result<void> add_frame(ByteView message, TimeUs now_us);
  /// The same, but what follows from it waits for deliver(): of several messages that came at once, all that a watcher
  /// gets is offered in one call.
  Result<void> take_frame(ByteView message, TimeUs now_us);
  void deliver();
  /// See Feed::prepare.
  void prepare();

  // For one that mirrors a stream of another loop.

  /// Whoever begins to watch is told nothing until stand_at().
  void await_standing() { awaits_standing_ = true; }
  /// Goes on from where the other one stands. REQUIRES: what announce() requires. Errors: as announce().
  Result<void> stand_at(const Standing& standing);
  /// As take_frame(), of a key that another loop took.
  void take_record(const KeyRecordPtr& record, TimeUs now_us);
  /// The sender is gone: the last pose is held.
  void stall();
  /// Sends all watchers away.
  void dismiss(const Error& why);

  // For the one that is mirrored.

  Standing standing() const;
  /// It is kept while `mirrored`; then its hub must be told that somebody left.
  void set_mirrored(bool mirrored) { mirrored_ = mirrored; }
  bool is_mirrored() const { return mirrored_; }
  /// What its mirrors' watchers want traced: as trace_every().
  void trace_elsewhere(std::uint32_t every);
  /// Watchers came or left in another loop.
  void tell_count();

  /// Adds a watcher, or changes its profile. Calls on_stream_changed. Errors: kTooLarge (too many watchers or
  /// profiles).
  Result<void> watch(Watcher& watcher, const Profile& profile);
  void unwatch(Watcher& watcher);

  /// Sends what is due by now.
  void pump(TimeUs now_us);
  std::optional<TimeUs> next_due_us() const;

  /// The watcher wants traces of every so many keys; 0: none. Ignored from who does not watch.
  void trace(Watcher& watcher, std::uint32_t every);
  /// What the sender is to trace: the least that a watcher wants; 0: nothing.
  std::uint32_t trace_every() const;
  /// Passes a sender's trace on to those who want it.
  void relay_trace(const control::Trace& trace);

  /// The join frame of this watcher's profile as it stands now; null before the first key.
  FramePtr join_for(const Watcher& watcher);
  /// As the watcher is told it.
  control::StreamInfo info_for(const Watcher& watcher) const;

  const std::string& name() const { return name_; }
  std::uint32_t id() const { return id_; }
  std::uint32_t epoch() const { return epoch_; }
  const std::string& asset() const { return announced_.asset; }
  /// The last announcement; empty before the first.
  const control::Announce& announcement() const { return announced_; }
  const CoefficientLayout& layout() const { return layout_; }
  double key_rate_hz() const { return announced_.key_rate_hz; }
  control::StreamInfo::State state() const;
  /// In all loops; and in this one.
  std::uint32_t watchers() const { return share_->watchers.load(std::memory_order_relaxed); }
  std::uint32_t watchers_here() const { return static_cast<std::uint32_t>(profiles_.size()); }
  bool has_publisher() const { return publisher_ != nullptr; }
  std::uint64_t keys_received() const { return keys_received_; }
  std::uint64_t frames_made() const { return frames_made_; }
  /// Poses of any feed that could not be coded.
  std::uint64_t poses_failed() const { return poses_failed_; }
  /// 0 while nothing is announced.
  std::uint8_t bands() const { return static_cast<std::uint8_t>(layout_.band_ends.size()); }
  std::size_t profile_count() const { return groups_.size(); }

 private:
  friend class Hub;
  struct Group {
    Group(const Profile& profile, const Feed::Source& source) : feed(profile, source) {}
    Feed feed;
    std::vector<Watcher*> watchers;
    std::vector<FramePtr> leaving;  ///< Made, and waiting for deliver().
    std::vector<FramePtr> traced;   ///< Frames whose traces are still to be told.
  };

  Profile effective(const Profile& wanted) const;
  void note_wanted(const Watcher& watcher, const Profile& profile);
  void forget_wanted(const Watcher& watcher);
  void join_group(Watcher& watcher, const Profile& wanted);
  void leave_group(Watcher& watcher);
  void deliver(Group& group);
  void tell_traces(Group& group);
  Result<void> take_place(Watcher& watcher);
  Result<KeyRecordPtr> record_from(const FrameView& frame, TimeUs now_us) const;

  std::string name_;
  std::shared_ptr<StreamShare> share_;
  std::uint32_t id_;
  Settings settings_;
  PublisherLink* publisher_ = nullptr;
  std::uint32_t epoch_ = 0;
  bool publishing_ = false;  ///< The present publisher has announced.
  bool awaits_standing_ = false;
  bool mirrored_ = false;
  std::uint32_t trace_elsewhere_ = 0;
  control::Announce announced_;
  CoefficientLayout layout_;
  KeyRecordPtr newest_;
  std::unordered_map<const Watcher*, Profile> profiles_;  ///< What each watcher asked for, see canonical().
  std::map<Profile, std::uint32_t> wanted_;               ///< How many ask for each; holds before any epoch and in all.
  std::unordered_map<const Watcher*, Group*> group_of_;
  std::map<Profile, std::unique_ptr<Group>> groups_;
  std::vector<Watcher*> order_;    ///< All watchers, waiting ones too.
  bool has_leaving_ = false;       ///< Of any group.
  std::optional<TimeUs> wake_us_;  ///< Its hub's: when it will be pumped next.
  Tracer tracer_;
  std::uint64_t keys_received_ = 0;
  std::uint64_t frames_made_ = 0;
  std::uint64_t poses_failed_ = 0;
};

}  // namespace eigencast::broker
