// SPDX-License-Identifier: MIT
#include "broker/backbone/following.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "broker/backbone/follower.h"
#include "broker/storage/segments.h"

namespace eigencast::broker {
namespace {

constexpr TimeUs kMemoryRetryUs = 10'000'000;
constexpr double kTellUs = 10;  ///< A viewer: as a sender here pays.

bool is_join(ByteView message) {
  const auto frame = parse_frame(message.subspan(std::min(message.size(), Follower::kHeadBytes)));
  return frame && frame->envelope.kind == FrameKind::kJoin;
}

}  // namespace

/// Feeds one epoch of a remote stream in the role of its sender; state of following it.
struct Following::Remote final : PublisherLink {
  enum class Phase : std::uint8_t {
    kWaiting,   ///< Requests the surface at `next_us`.
    kFetching,  ///< The surface is being copied.
    kFetched,   ///< The surface is complete; the stream can begin.
    kFollowing,
    kUnusable,  ///< Until the directory names another epoch.
  };

  Remote(Stream& of, DirectoryEntry known) : stream(&of), entry(std::move(known)), follower(entry.epoch) {}

  // Local senders take precedence.
  bool yields() const override { return true; }
  void on_replaced() override { stream = nullptr; }
  void on_watcher_count(std::uint32_t) override {}
  /// Whether only messages and what is noted can change it.
  bool is_settled() const {
    return phase == Phase::kFetching || phase == Phase::kUnusable ||
           (phase == Phase::kFollowing && follower.is_joined() && !wants_memory());
  }
  /// Whether there is one that is not used yet, and may be.
  bool wants_memory() const { return wanted.root != 0 && about_memory && !(recalls && held == wanted); }

  Stream* stream;  ///< Null once it no longer feeds the stream.
  const DirectoryEntry entry;
  Follower follower;
  Phase phase = Phase::kWaiting;
  TimeUs next_us = 0;
  std::string next = {};  ///< As in the directory; fetched for the viewers here.
  bool fetches_next = false;
  bool watched = true;
  TimeUs watched_us = 0;               ///< When the stream last had watchers.
  std::shared_ptr<void> subscription;  ///< To keys that need no memory; null: `recalls`.

  std::shared_ptr<void> about_memory;  ///< A subscription; null: there is to be none here.
  MemoryNotice wanted, held;           ///< The owner's, and what of it is the stream's here.
  bool loading = false;                ///< `loading_what`, into `held`.
  MemoryNotice loading_what;
  bool recalls = false;       ///< Its keys are those of the sender.
  TimeUs memory_next_us = 0;  ///< When to fetch, or to ask for the sender's chain.
};

Following::~Following() {
  stop();
}

void Following::stop() {
  for (const auto& [name, remote] : remotes_) remote->subscription = remote->about_memory = nullptr;
  for (const auto& [name, remote] : std::exchange(remotes_, {})) {
    if (remote->stream != nullptr) remote->stream->release(*remote);
  }
  changed_.clear();
  later_.clear();
  hub_ = nullptr;
}

bool Following::feeds(std::string_view name) const {
  const auto found = remotes_.find(name);
  return found != remotes_.end() && found->second->stream != nullptr;
}

void Following::forget_stream(std::string_view name) {
  if (const auto found = remotes_.find(name); found != remotes_.end()) found->second->stream = nullptr;
}

void Following::reconcile(bool connected, bool complete) {
  for (const std::string& name : take_changed()) {
    ++totals_.names_compared;
    const auto former = remotes_.find(name);
    if (former != remotes_.end() && is_over(*former->second, complete)) unfollow(name);
    if (Stream* stream = hub_->find(name)) {
      if (const DirectoryEntry* entry = wanted_entry(*stream)) follow(*stream, *entry);
    }
    const auto found = remotes_.find(name);
    if (found == remotes_.end()) continue;
    const RemotePtr remote = found->second;
    if (connected) advance(remote);
    if (!remote->is_settled()) later_.insert(name);
  }
}

std::vector<std::string> Following::take_changed() {
  const auto changed = std::exchange(changed_, {});
  const TimeUs now = environment_.now_us();
  if (now < next_sweep_us_) return {changed.begin(), changed.end()};
  next_sweep_us_ = now + settings_.sweep_us;
  std::vector<std::string> names;
  for (const Stream* stream : hub_->streams()) {
    if (!stream->has_publisher() && stream->watchers() > 0) names.push_back(stream->name());
  }
  for (const auto& [name, remote] : remotes_) names.push_back(name);
  return names;
}

bool Following::is_over(Remote& remote, bool complete) const {
  if (remote.stream == nullptr) return true;
  const TimeUs now = environment_.now_us();
  const bool was_watched = std::exchange(remote.watched, remote.stream->watchers() > 0);
  if (was_watched || remote.watched) remote.watched_us = now;
  if (now - remote.watched_us >= settings_.linger_us) return true;
  const DirectoryEntry* holder = directory_.live(remote.stream->name(), now);
  if (holder == nullptr) return complete;
  return holder->owner != remote.entry.owner || holder->epoch != remote.entry.epoch;
}

/// Null: the stream has no sender elsewhere, or is not watched.
const DirectoryEntry* Following::wanted_entry(const Stream& stream) const {
  if (stream.has_publisher() || stream.watchers() == 0) return nullptr;
  const DirectoryEntry* holder = directory_.live(stream.name(), environment_.now_us());
  return holder == nullptr || holder->owner == settings_.id || holder->epoch < stream.epoch() ? nullptr : holder;
}

void Following::follow(Stream& stream, const DirectoryEntry& entry) {
  unfollow(stream.name());
  auto remote = std::make_shared<Remote>(stream, entry);
  remote->watched_us = environment_.now_us();
  // Registered first, so that taps see a remote stream.
  remotes_[stream.name()] = remote;
  if (const auto claimed = stream.claim(*remote, true); !claimed) remotes_.erase(stream.name());
}

void Following::unfollow(const std::string& name) {
  const auto found = remotes_.find(name);
  if (found == remotes_.end()) return;
  const RemotePtr remote = found->second;
  remotes_.erase(found);
  remote->subscription = remote->about_memory = nullptr;
  Stream* stream = std::exchange(remote->stream, nullptr);
  if (stream == nullptr) return;
  stream->release(*remote);
  hub_->unwatched(*stream);
}

void Following::advance(const RemotePtr& remote) {
  const TimeUs now = environment_.now_us();
  if (remote->stream == nullptr) return;
  if (remote->phase == Remote::Phase::kWaiting && now >= remote->next_us) fetch_surface(remote);
  if (remote->phase == Remote::Phase::kFetched && may_tell(*remote)) begin(remote);
  if (remote->phase != Remote::Phase::kFollowing) return;
  fetch_next(remote);
  if (remote->follower.wants_join(now)) ask_join(remote);
  if (!remote->wants_memory() || remote->loading || now < remote->memory_next_us) return;
  remote->memory_next_us = now + settings_.retry_us;
  if (remote->held == remote->wanted) return ask_memory(remote);
  remote->loading = true;
  remote->loading_what = remote->wanted;
  fetch_segments(remote, 0);
}

void Following::fetch_surface(const RemotePtr& remote) {
  remote->phase = Remote::Phase::kFetching;
  const auto asset = Sha256::from_hex(remote->entry.announce.asset);
  if (!asset) {
    remote->phase = Remote::Phase::kUnusable;
    return;
  }
  const auto took = [this, weak = std::weak_ptr(remote)](const Result<void>& fetched) {
    const auto still = weak.lock();
    if (!still || still->stream == nullptr) return;
    note(still->stream->name());
    if (fetched) {
      still->phase = Remote::Phase::kFetched;
      return;
    }
    still->phase = Remote::Phase::kWaiting;
    still->next_us = environment_.now_us() + settings_.retry_us;
    environment_.warn("the surface of stream '" + still->stream->name() +
                      "' does not come, trying again: " + fetched.error().message);
  };
  assets_.fetch(remote->entry.owner, *asset, payer_of(remote->entry), environment_.now_us(), took);
}

/// So that the next epoch begins without waiting for its surface, here and at the viewers.
void Following::fetch_next(const RemotePtr& remote) {
  const DirectoryEntry* holder = directory_.live(remote->stream->name(), environment_.now_us());
  const DirectoryEntry& entry = remote->entry;
  if (holder == nullptr || holder->owner != entry.owner || holder->epoch != entry.epoch || holder->next == remote->next)
    return;
  if (remote->fetches_next || !may_tell(*remote)) return;
  const std::string former = std::exchange(remote->next, holder->next);
  const auto asset = Sha256::from_hex(remote->next);
  if (!asset) {
    remote->stream->prepare(nullptr);
    return hub_->mark_dirty(*remote->stream);
  }
  remote->fetches_next = true;
  const auto took = [this, weak = std::weak_ptr(remote), id = remote->next, former](const Result<void>& fetched) {
    const auto still = weak.lock();
    if (!still || still->stream == nullptr) return;
    still->fetches_next = false;
    if (!fetched && fetched.error().code == ErrorCode::kRefused) {  // Again at the next sweep.
      still->next = former;
      return;
    }
    note(still->stream->name());  // Another may be known by now.
    if (!fetched) return;
    still->stream->prepare(std::make_shared<const control::StreamInfo::Next>(control::StreamInfo::Next{id, 1}));
    hub_->mark_dirty(*still->stream);
  };
  assets_.fetch(entry.owner, *asset, payer_of(entry), environment_.now_us(), took);
}

bool Following::may_tell(const Remote& remote) {
  const double work_us = kTellUs * remote.stream->watchers();
  if (work_.take_change(remote.entry.owner, remote.entry.sender, work_us, environment_.now_us())) return true;
  later_.insert(remote.stream->name());
  return false;
}

void Following::begin(const RemotePtr& remote) {
  Stream& stream = *remote->stream;
  const DirectoryEntry& entry = remote->entry;
  if (const auto held = hub_->hold_keys(stream, {payer_of(entry), true}, entry.announce.format); !held) {
    remote->phase = Remote::Phase::kWaiting;
    remote->next_us = environment_.now_us() + settings_.retry_us;
    return environment_.warn("stream '" + stream.name() + "' is not followed yet: " + held.error().message);
  }
  if (const auto begun = stream.announce(entry.announce, entry.epoch); !begun) {
    remote->phase = Remote::Phase::kUnusable;
    return environment_.warn("stream '" + stream.name() + "' cannot be followed: " + begun.error().message);
  }
  environment_.inform("stream '" + stream.name() + "' of broker " + entry.owner + " is followed, epoch " +
                      std::to_string(entry.epoch));
  remote->phase = Remote::Phase::kFollowing;
  take_plain_frames(remote);
  if (!environment_.remembers() || codec_from_name(entry.announce.format.codec).value() != CodecKind::kQuantised)
    return;
  remote->about_memory = link_.subscribe(subject_of_memory(frames_of(entry, stream.name())),
                                         [this, weak = std::weak_ptr(remote)](const std::string&, Bytes message) {
                                           if (const auto still = weak.lock()) take_memory(still, message);
                                         });
  ask_memory(remote);
}

std::string Following::frames_of(const DirectoryEntry& entry, const std::string& stream) const {
  return settings_.prefix + ".frames." + entry.owner + "." + token_from_stream(stream);
}

/// From the next join on.
void Following::take_plain_frames(const RemotePtr& remote) {
  remote->recalls = false;
  remote->follower.change_chain();
  remote->memory_next_us = environment_.now_us() + settings_.retry_us;
  note(remote->stream->name());
  remote->subscription = link_.subscribe(frames_of(remote->entry, remote->stream->name()),
                                         [this, weak = std::weak_ptr(remote)](const std::string&, Bytes message) {
                                           if (const auto still = weak.lock()) take(still, std::move(message), false);
                                         });
  if (remote->follower.wants_join(environment_.now_us())) ask_join(remote);
}

void Following::ask_join(const RemotePtr& remote) {
  Bytes request;
  ByteWriter out(request);
  out.u32(remote->entry.epoch);
  out.text(remote->stream->name());
  ++totals_.joins_asked;
  link_.ask(settings_.prefix + ".joins." + remote->entry.owner, std::move(request), Follower::kJoinTimeoutUs,
            [this, weak = std::weak_ptr(remote)](Result<Bytes> answer) {
              const auto still = weak.lock();
              if (still && answer && !answer->empty()) take(still, std::move(*answer), false);
            });
}

/// `recalled`: of the sender's chain, else of that without a memory.
void Following::take(const RemotePtr& kept, Bytes message, bool recalled) {
  Remote& remote = *kept;
  if (remote.stream == nullptr) return;
  // The sender's chain goes on from a join; what comes late of the other one is of no use then.
  if (recalled != remote.recalls && !(recalled && remote.follower.is_joined() && is_join(message))) return;
  if (!remote.follower.is_of_epoch(message)) {  // Perhaps not its broker's: the sender does not pay for it.
    ++totals_.frames_dropped;
    return;
  }
  const double work_us = 1 + remote.stream->decoding_us(message.size(), true);
  if (!work_.take_frame(remote.entry.owner, remote.entry.sender, work_us, environment_.now_us())) {
    ++totals_.frames_dropped;
    return environment_.warn("frames of stream '" + remote.stream->name() + "' of broker " + remote.entry.owner +
                             " are left out: those of its sender take too much computing");
  }
  const std::uint64_t dropped = remote.follower.dropped();
  for (const Follower::Followed& followed : remote.follower.take(std::move(message))) {
    if (const auto added = remote.stream->take_frame(followed.frame, environment_.now_us()); !added) {
      environment_.warn("stream '" + remote.stream->name() +
                        "': a frame of another broker is refused, asking for a join: " + added.error().message);
      remote.follower.restart();
      break;
    }
    ++totals_.frames_followed;
    if (std::exchange(remote.recalls, recalled) != recalled) remote.subscription.reset();
  }
  totals_.frames_dropped += remote.follower.dropped() - dropped;
  if (const double more_us = remote.stream->take_unpaid_us(); more_us > 0)
    work_.charge_frames(remote.entry.owner, remote.entry.sender, more_us, environment_.now_us());
  if (remote.recalls && !remote.follower.is_joined()) take_plain_frames(kept);
  if (!remote.follower.is_joined()) note(remote.stream->name());
  hub_->mark_dirty(*remote.stream);
  environment_.frames_came();
}

/// For what the owner's stream remembers, and for a join of the sender's chain with the next key.
void Following::ask_memory(const RemotePtr& remote) {
  Bytes request;
  ByteWriter out(request);
  out.u32(remote->entry.epoch);
  out.text(remote->stream->name() + "=");
  link_.ask(settings_.prefix + ".joins." + remote->entry.owner, std::move(request), Follower::kJoinTimeoutUs,
            [this, weak = std::weak_ptr(remote)](Result<Bytes> answer) {
              const auto still = weak.lock();
              if (still && answer && !answer->empty()) take_memory(still, *answer);
            });
}

void Following::take_memory(const RemotePtr& remote, ByteView bytes) {
  if (remote->stream == nullptr || !remote->about_memory) return;
  auto message = memory_message_from(bytes);
  if (!message)
    return environment_.warn("stream '" + remote->stream->name() + "': a message about its memory is malformed");
  if (message->notice) return note_memory(remote, *std::move(message->notice));
  const bool is_held = remote->held.root == message->root && message->number <= remote->held.number;
  if (is_held) return take(remote, std::move(message->frame), true);
  if (remote->recalls) take_plain_frames(remote);
  const bool is_coming = remote->wanted.root == message->root && message->number <= remote->wanted.number;
  if (is_coming || environment_.now_us() < remote->memory_next_us) return;
  remote->memory_next_us = environment_.now_us() + settings_.retry_us;
  ask_memory(remote);  // A notice was lost.
}

void Following::note_memory(const RemotePtr& remote, MemoryNotice notice) {
  if (notice.epoch != remote->entry.epoch || notice.number < remote->wanted.number || notice == remote->wanted) return;
  const bool goes_on = remote->held.goes_on_as(notice);
  remote->wanted = std::move(notice);
  remote->memory_next_us = 0;
  note(remote->stream->name());
  if (goes_on || remote->held.root == 0) return;
  if (remote->recalls) take_plain_frames(remote);
  remote->held = {};
  remote->stream->set_memory(nullptr);
  hub_->mark_dirty(*remote->stream);
}

/// One after the other, from the `first` on.
void Following::fetch_segments(const RemotePtr& remote, std::size_t first) {
  if (first == remote->loading_what.segments.size()) return load_memory(remote);
  const auto took = [this, weak = std::weak_ptr(remote), first](const Result<void>& fetched) {
    const auto still = weak.lock();
    if (!still || still->stream == nullptr) return;
    if (!fetched) return retry_memory(*still, fetched.error());
    fetch_segments(still, first + 1);
  };
  assets_.fetch(remote->entry.owner, remote->loading_what.segments[first], payer_of(remote->entry),
                environment_.now_us(), took);
}

void Following::load_memory(const RemotePtr& remote) {
  struct Loading {
    std::vector<Generation::Segment> segments;
    Result<void> done;
  };
  const auto loading = std::make_shared<Loading>();
  if (const auto& memory = remote->stream->memory()) loading->segments = memory->segments;
  const auto& ids = remote->loading_what.segments;
  for (std::size_t i = loading->segments.size(); i < ids.size(); ++i)
    loading->segments.push_back({ids[i].hex(), nullptr, 0});
  const AssetDigest asset = Sha256::from_hex(remote->entry.announce.asset)->digest;
  const auto wanted = [weak = std::weak_ptr(remote)] {
    const auto still = weak.lock();
    return still && still->stream != nullptr;
  };
  const auto load = [loading, &store = assets_.store(), layout = remote->stream->layout(), asset] {
    loading->done = load_segments(store, layout, asset, loading->segments);
  };
  const auto then = [this, loading, weak = std::weak_ptr(remote)] {
    const auto still = weak.lock();
    if (still && still->stream != nullptr) remember(still, std::move(loading->segments), loading->done);
  };
  if (!environment_.read_memory(payer_of(remote->entry), {wanted, load, then}))
    retry_memory(*remote, fail(ErrorCode::kRefused, "too many memories of its sender wait to be read"));
}

void Following::remember(const RemotePtr& remote, std::vector<Generation::Segment> segments,
                         const Result<void>& loaded) {
  if (!loaded) return retry_memory(*remote, loaded.error());
  remote->loading = false;
  note(remote->stream->name());
  if (!remote->loading_what.goes_on_as(remote->wanted)) return;  // Overtaken.
  Stream& stream = *remote->stream;
  double poses = 0;
  for (const auto& segment : segments) poses += segment.since == 0 ? segment.poses->poses : 0;
  const double work_us = poses * stream.decoding_us(stream.layout().size() / 4, true);
  Result<void> held = fail(ErrorCode::kTooLarge, "the streams of its sender take too much computing");
  if (work_.take_frame(remote->entry.owner, remote->entry.sender, work_us, environment_.now_us()) && may_tell(*remote))
    held = hub_->remember(stream, std::move(segments));
  if (!held) return retry_memory(*remote, held.error());
  remote->held = remote->loading_what;
  remote->memory_next_us = 0;
  hub_->mark_dirty(stream);
}

/// The stream goes on without.
void Following::retry_memory(Remote& remote, const Error& why) {
  remote.loading = false;
  remote.memory_next_us = environment_.now_us() + kMemoryRetryUs;
  note(remote.stream->name());
  environment_.warn("the memory of stream '" + remote.stream->name() + "' is not used yet: " + why.message);
}

}  // namespace eigencast::broker
