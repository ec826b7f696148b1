// SPDX-License-Identifier: MIT
#include "broker/relay/mirror.h"

#include <algorithm>
#include <utility>

namespace eigencast::broker {

// ---- Where the senders are ----

Mirrored::Mirrored(std::size_t loops, Surroundings surroundings)
    : surroundings_(std::move(surroundings)), ways_(loops) {}

void Mirrored::take(Hub& hub, std::size_t loop, const MirrorAsks& asks) {
  for (const MirrorAsk& ask : asks) {
    if (ask.kind == MirrorAsk::Kind::kFollow) {
      follow(hub, loop, ask);
      continue;
    }
    const auto found = followed_.find(ask.stream);
    if (found == followed_.end() || !found->second.trace_every.contains(loop)) continue;  // It was told: not to be had.
    if (ask.kind == MirrorAsk::Kind::kLetGo) {
      let_go(hub, loop, found->second);
      continue;
    }
    found->second.trace_every[loop] = ask.trace_every;
    tell_sender(found->second);
  }
}

void Mirrored::tell_sender(const Followed& followed) {
  std::uint32_t least = 0;
  for (const auto& [loop, every] : followed.trace_every) {
    if (every != 0 && (least == 0 || every < least)) least = every;
  }
  followed.stream->trace_elsewhere(least);
  followed.stream->tell_count();
}

void Mirrored::follow(Hub& hub, std::size_t loop, const MirrorAsk& ask) {
  const auto stream = hub.open(ask.stream);
  if (!stream) return push(loop, {ask.stream_id, std::make_shared<const Error>(stream.error())});
  Followed& followed = followed_[ask.stream];
  followed.stream = *stream;
  followed.trace_every[loop] = 0;
  followed.stream->set_mirrored(true);
  push(loop, {followed.stream->id(), std::make_shared<const Standing>(followed.stream->standing())});
  followed.stream->tell_count();
}

void Mirrored::let_go(Hub& hub, std::size_t loop, Followed& followed) {
  Stream& stream = *followed.stream;
  followed.trace_every.erase(loop);
  tell_sender(followed);
  if (!followed.trace_every.empty()) return;
  followed_.erase(stream.name());
  stream.set_mirrored(false);
  hub.left(stream);
}

void Mirrored::on_announced(const Stream& stream) {
  if (followed_.empty()) return;
  tell_all(stream, {stream.id(), std::make_shared<const Standing>(stream.standing())});
}

void Mirrored::on_key(const Stream& stream, const KeyRecordPtr& record) {
  if (!followed_.empty()) tell_all(stream, {stream.id(), record});
}

void Mirrored::on_stalled(const Stream& stream) {
  tell_all(stream, {stream.id(), MirrorEvent::Stalled{}});
}

void Mirrored::on_trace(const Stream& stream, const control::Trace& trace) {
  if (followed_.empty()) return;
  tell_all(stream, {stream.id(), std::make_shared<const control::Trace>(trace)});
}

void Mirrored::tell_all(const Stream& stream, const MirrorEvent& event) {
  const auto found = followed_.find(stream.name());
  if (found == followed_.end()) return;
  for (const auto& [loop, every] : found->second.trace_every) push(loop, event);
}

void Mirrored::push(std::size_t loop, MirrorEvent event) {
  Way& way = ways_[loop];
  const auto is_answer = [](const MirrorEvent& one) { return std::holds_alternative<MirrorEvent::ErrorPtr>(one.what); };
  if (way.behind && !is_answer(event)) return;
  way.waiting.push_back(std::move(event));
  if (way.sent + way.waiting.size() - surroundings_.taken(loop) > kMostUnderWay) {
    way.behind = true;
    std::erase_if(way.waiting, [&](const MirrorEvent& one) { return !is_answer(one); });
  }
  arm();
}

void Mirrored::arm() {
  if (!std::exchange(armed_, true)) surroundings_.flush_soon();
}

void Mirrored::flush() {
  armed_ = false;
  for (std::size_t loop = 0; loop < ways_.size(); ++loop) {
    Way& way = ways_[loop];
    if (way.behind && surroundings_.taken(loop) == way.sent) catch_up(loop);
    if (way.waiting.empty()) continue;
    way.sent += way.waiting.size();
    surroundings_.send(loop, std::exchange(way.waiting, {}));
  }
}

void Mirrored::catch_up(std::size_t loop) {
  Way& way = ways_[loop];
  way.behind = false;
  for (const auto& [name, followed] : followed_) {
    if (!followed.trace_every.contains(loop)) continue;
    way.waiting.push_back({followed.stream->id(), std::make_shared<const Standing>(followed.stream->standing())});
  }
}

// ---- Where they are mirrored ----

/// Stands in the place of the sender.
class Mirrors::Mirror final : public PublisherLink {
 public:
  Mirror(Mirrors& mirrors, Stream& stream) : mirrors_(mirrors), stream_(stream) {
    stream.await_standing();
    (void)stream.claim(*this);  // Nobody publishes here.
  }
  void on_watcher_count(std::uint32_t) override { mirrors_.change(*this); }
  void on_trace_wanted() override { mirrors_.change(*this); }

  Stream& stream() { return stream_; }
  bool is_changed() const { return changed_; }
  void set_changed(bool changed) { changed_ = changed; }
  /// False until the origin has answered: what comes before is of an earlier mirror of the stream.
  bool stands() const { return stands_; }
  void set_stands() { stands_ = true; }
  /// The origin cannot have the stream: those who watched it are sent away, who comes meanwhile asks anew.
  void set_refused() { refused_ = true; }
  bool take_refusal() { return std::exchange(refused_, false); }

 private:
  Mirrors& mirrors_;
  Stream& stream_;
  bool changed_ = false;
  bool stands_ = false;
  bool refused_ = false;
};

Mirrors::Mirrors(Surroundings surroundings) : surroundings_(std::move(surroundings)) {}
Mirrors::~Mirrors() = default;

void Mirrors::on_opened(Stream& stream) {
  auto mirror = std::make_unique<Mirror>(*this, stream);
  ask(MirrorAsk::Kind::kFollow, stream);
  change(*mirror);
  mirrors_[stream.id()] = std::move(mirror);
}

void Mirrors::change(Mirror& mirror) {
  if (mirror.is_changed()) return;
  mirror.set_changed(true);
  changed_.push_back(mirror.stream().id());
  if (!std::exchange(armed_, true)) surroundings_.settle_soon();
}

void Mirrors::ask(MirrorAsk::Kind kind, const Stream& stream) {
  asks_.push_back({kind, stream.name(), stream.id(), stream.trace_every()});
}

void Mirrors::settle(Hub& hub) {
  armed_ = false;
  for (const std::uint32_t id : std::exchange(changed_, {})) {
    Mirror& mirror = *mirrors_.at(id);
    Stream& stream = mirror.stream();
    mirror.set_changed(false);
    if (stream.watchers_here() > 0) {
      if (mirror.take_refusal()) ask(MirrorAsk::Kind::kFollow, stream);
      ask(MirrorAsk::Kind::kChanged, stream);
      continue;
    }
    ask(MirrorAsk::Kind::kLetGo, stream);
    stream.release(mirror);
    mirrors_.erase(id);
    hub.drop(stream);
  }
  if (!asks_.empty()) surroundings_.ask(std::exchange(asks_, {}));
}

void Mirrors::take(Hub& hub, const MirrorEvents& events, TimeUs now_us) {
  for (const MirrorEvent& event : events) {
    const auto found = mirrors_.find(event.stream_id);
    if (found == mirrors_.end()) continue;
    Mirror& mirror = *found->second;
    Stream& stream = mirror.stream();
    if (const auto* standing = std::get_if<StandingPtr>(&event.what)) {
      mirror.set_stands();
      if ((*standing)->epoch < stream.epoch()) {
        stream.stall();  // The origin forgot it meanwhile.
      } else if (!stream.stand_at(**standing)) {
        continue;  // It does not come to that: the origin took the same.
      }
    } else if (const auto* error = std::get_if<MirrorEvent::ErrorPtr>(&event.what)) {
      mirror.set_refused();
      stream.dismiss(**error);
    } else if (!mirror.stands()) {
      continue;
    } else if (const auto* record = std::get_if<KeyRecordPtr>(&event.what)) {
      stream.take_record(*record, now_us);
    } else if (const auto* trace = std::get_if<MirrorEvent::TracePtr>(&event.what)) {
      stream.relay_trace(**trace);
    } else {
      stream.stall();
    }
    hub.owes(stream);
  }
}

}  // namespace eigencast::broker
