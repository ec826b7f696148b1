// SPDX-License-Identifier: MIT
#include "broker/backbone/following.h"

#include <utility>
#include <vector>

#include "broker/backbone/follower.h"

namespace eigencast::broker {

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
           (phase == Phase::kFollowing && follower.is_joined());
  }

  Stream* stream;  ///< Null once it no longer feeds the stream.
  const DirectoryEntry entry;
  Follower follower;
  Phase phase = Phase::kWaiting;
  TimeUs next_us = 0;
  bool watched = true;
  TimeUs watched_us = 0;  ///< When the stream last had watchers.
  std::shared_ptr<void> subscription;
};

Following::~Following() {
  stop();
}

void Following::stop() {
  for (const auto& [name, remote] : remotes_) remote->subscription.reset();
  for (const auto& [name, remote] : std::exchange(remotes_, {})) {
    if (remote->stream != nullptr) remote->stream->release(*remote);
  }
  changed_.clear();
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
    if (!remote->is_settled()) note(name);
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
  remote->subscription.reset();
  Stream* stream = std::exchange(remote->stream, nullptr);
  if (stream == nullptr) return;
  stream->release(*remote);
  hub_->unwatched(*stream);
}

void Following::advance(const RemotePtr& remote) {
  const TimeUs now = environment_.now_us();
  if (remote->stream == nullptr) return;
  if (remote->phase == Remote::Phase::kWaiting && now >= remote->next_us) fetch_surface(remote);
  if (remote->phase == Remote::Phase::kFetched) begin(remote);
  if (remote->phase == Remote::Phase::kFollowing && remote->follower.wants_join(now)) ask_join(remote);
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
  const std::string frames = settings_.prefix + ".frames." + entry.owner + "." + token_from_stream(stream.name());
  remote->subscription =
      link_.subscribe(frames, [this, weak = std::weak_ptr(remote)](const std::string&, Bytes message) {
        if (const auto still = weak.lock()) take(*still, std::move(message));
      });
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
              if (still && answer && !answer->empty()) take(*still, std::move(*answer));
            });
}

void Following::take(Remote& remote, Bytes message) {
  if (remote.stream == nullptr) return;
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
  }
  totals_.frames_dropped += remote.follower.dropped() - dropped;
  if (!remote.follower.is_joined()) note(remote.stream->name());
  hub_->mark_dirty(*remote.stream);
  hub_->deliver();
  environment_.frames_came();
}

}  // namespace eigencast::broker
