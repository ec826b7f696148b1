// SPDX-License-Identifier: MIT
#include "broker/relay/mirror.h"

#include <utility>

namespace eigencast::broker {

std::uint64_t cost_of(const MirrorEvent& event) {
  const auto* record = std::get_if<KeyRecordPtr>(&event.what);
  return 1 + (record != nullptr ? memory_of(**record) / 4096 : 0);
}

MirrorOrigin::MirrorOrigin(std::size_t loops, Environment environment)
    : environment_(std::move(environment)), channels_(loops) {}

void MirrorOrigin::take(Hub& hub, std::size_t loop, const MirrorRequests& requests) {
  for (const MirrorRequest& request : requests) {
    if (request.kind == MirrorRequest::Kind::kFollow) {
      follow(hub, loop, request);
      continue;
    }
    const auto found = followed_.find(request.stream);
    if (found == followed_.end() || !found->second.trace_every.contains(loop)) continue;
    if (request.kind == MirrorRequest::Kind::kRelease) {
      release_stream(hub, loop, found->second);
      continue;
    }
    found->second.trace_every[loop] = request.trace_every;
    notify_sender(found->second);
  }
}

void MirrorOrigin::notify_sender(const Followed& followed) {
  std::uint32_t least = 0;
  for (const auto& [loop, every] : followed.trace_every) least = shorter_interval(least, every);
  followed.stream->set_mirror_trace(least);
  followed.stream->report_count();
}

void MirrorOrigin::follow(Hub& hub, std::size_t loop, const MirrorRequest& request) {
  const auto stream = hub.open(request.stream);
  if (!stream) return;  // No ids left: the mirror, which has one, is gone.
  Followed& followed = followed_[request.stream];
  followed.stream = *stream;
  followed.trace_every[loop] = 0;
  followed.stream->set_mirrored(true);
  push(loop, {followed.stream->share(), std::make_shared<const Snapshot>(followed.stream->snapshot())});
  followed.stream->report_count();
}

void MirrorOrigin::release_stream(Hub& hub, std::size_t loop, Followed& followed) {
  Stream& stream = *followed.stream;
  followed.trace_every.erase(loop);
  notify_sender(followed);
  if (!followed.trace_every.empty()) return;
  followed_.erase(stream.name());
  stream.set_mirrored(false);
  hub.unwatched(stream);
}

void MirrorOrigin::on_announced(const Stream& stream) {
  if (followed_.empty()) return;
  broadcast(stream, {stream.share(), std::make_shared<const Snapshot>(stream.snapshot())});
}

void MirrorOrigin::on_key(const Stream& stream, const KeyRecordPtr& record) {
  if (!followed_.empty()) broadcast(stream, {stream.share(), record});
}

void MirrorOrigin::on_stalled(const Stream& stream) {
  broadcast(stream, {stream.share(), MirrorEvent::Stalled{}});
}

void MirrorOrigin::on_trace(const Stream& stream, const control::Trace& trace) {
  if (followed_.empty()) return;
  broadcast(stream, {stream.share(), std::make_shared<const control::Trace>(trace)});
}

void MirrorOrigin::on_memory(const Stream& stream) {
  if (!followed_.empty()) broadcast(stream, {stream.share(), stream.memory()});
}

void MirrorOrigin::on_next(const Stream& stream) {
  if (!followed_.empty()) broadcast(stream, {stream.share(), stream.snapshot().next});
}

void MirrorOrigin::broadcast(const Stream& stream, const MirrorEvent& event) {
  const auto found = followed_.find(stream.name());
  if (found == followed_.end()) return;
  for (const auto& [loop, every] : found->second.trace_every) push(loop, event);
}

void MirrorOrigin::push(std::size_t loop, MirrorEvent event) {
  Channel& channel = channels_[loop];
  if (channel.behind) return;
  channel.waiting.push_back(std::move(event));
  channel.sent += cost_of(channel.waiting.back());
  if (channel.sent - environment_.taken(loop) > kMaxInFlight) {
    channel.behind = true;
    for (const MirrorEvent& waiting : std::exchange(channel.waiting, {})) channel.sent -= cost_of(waiting);
  }
  arm();
}

void MirrorOrigin::flush() {
  armed_ = false;
  for (std::size_t loop = 0; loop < channels_.size(); ++loop) {
    Channel& channel = channels_[loop];
    if (channel.behind && environment_.taken(loop) == channel.sent) catch_up(loop);
    if (channel.waiting.empty()) continue;
    environment_.send(loop, std::exchange(channel.waiting, {}));
  }
}

void MirrorOrigin::catch_up(std::size_t loop) {
  Channel& channel = channels_[loop];
  channel.behind = false;
  for (const auto& [name, followed] : followed_) {
    if (!followed.trace_every.contains(loop)) continue;
    channel.waiting.push_back(
        {followed.stream->share(), std::make_shared<const Snapshot>(followed.stream->snapshot())});
    channel.sent += cost_of(channel.waiting.back());
  }
}

/// Takes the sender's role in a mirror.
class MirrorSet::Mirror final : public PublisherLink {
 public:
  Mirror(MirrorSet& mirrors, Stream& mirrored) : stream(mirrored), mirrors_(mirrors) {
    stream.await_snapshot();
    (void)stream.claim(*this);  // A mirror has no other publisher.
  }
  void on_watcher_count(std::uint32_t) override { mirrors_.change(*this); }
  void on_trace_wanted() override { mirrors_.change(*this); }

  Stream& stream;
  bool changed = false;
  bool synced = false;  ///< The origin has answered: earlier events belong to a previous mirror of the stream.

 private:
  MirrorSet& mirrors_;
};

MirrorSet::MirrorSet(Environment environment) : environment_(std::move(environment)) {}
MirrorSet::~MirrorSet() = default;

void MirrorSet::on_opened(Stream& stream) {
  auto mirror = std::make_unique<Mirror>(*this, stream);
  request(MirrorRequest::Kind::kFollow, stream);
  change(*mirror);
  mirrors_[stream.id()] = std::move(mirror);
}

void MirrorSet::change(Mirror& mirror) {
  if (std::exchange(mirror.changed, true)) return;
  changed_.push_back(mirror.stream.id());
  if (!std::exchange(armed_, true)) environment_.flush_soon();
}

void MirrorSet::request(MirrorRequest::Kind kind, const Stream& stream) {
  requests_.push_back({kind, stream.name(), stream.id(), stream.trace_every()});
}

void MirrorSet::flush(Hub& hub) {
  armed_ = false;
  for (const std::uint32_t id : std::exchange(changed_, {})) {
    Mirror& mirror = *mirrors_.at(id);
    Stream& stream = mirror.stream;
    mirror.changed = false;
    if (stream.watchers_here() > 0) {
      request(MirrorRequest::Kind::kChanged, stream);
      continue;
    }
    request(MirrorRequest::Kind::kRelease, stream);
    stream.release(mirror);
    mirrors_.erase(id);
    hub.drop(stream);
  }
  if (!requests_.empty()) environment_.request(std::exchange(requests_, {}));
}

void MirrorSet::take(Hub& hub, const MirrorEvents& events, TimeUs now_us) {
  for (const MirrorEvent& event : events) {
    const auto found = mirrors_.find(event.share->id);
    if (found == mirrors_.end()) continue;
    Mirror& mirror = *found->second;
    Stream& stream = mirror.stream;
    if (const auto* snapshot = std::get_if<SnapshotPtr>(&event.what)) {
      mirror.synced = true;
      if ((*snapshot)->epoch < stream.epoch()) {
        stream.stall();  // The origin removed it meanwhile.
      } else if (!stream.restore(**snapshot)) {
        continue;  // Unreachable: the origin accepted the same snapshot.
      }
    } else if (!mirror.synced) {
      continue;
    } else if (const auto* record = std::get_if<KeyRecordPtr>(&event.what)) {
      stream.take_record(*record, now_us);
    } else if (const auto* memory = std::get_if<GenerationPtr>(&event.what)) {
      stream.set_memory(*memory);
    } else if (const auto* next = std::get_if<NextPtr>(&event.what)) {
      stream.set_next(*next);
    } else if (const auto* trace = std::get_if<MirrorEvent::TracePtr>(&event.what)) {
      stream.relay_trace(**trace);
    } else {
      stream.stall();
    }
    hub.mark_dirty(stream);
  }
}

}  // namespace eigencast::broker
