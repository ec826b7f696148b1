// SPDX-License-Identifier: MIT
#include "broker/connections/subscriber.h"

#include <algorithm>
#include <cstdlib>
#include <utility>

#include "broker/access/resume_secret.h"
#include "broker/relay/hub.h"
#include "broker/storage/history.h"
#include "broker/websocket/protocol.h"
#include "common/wire/limits.h"

namespace eigencast::broker {
namespace {

/// Of a message about a room: what its making costs, of which those that get the same share a part only.
constexpr double kNewsUs = 10, kNewsBytesPerUs = 50, kMomentUs = 1;
constexpr double kWriteUs = 5, kWrittenBytesPerUs = 1'000;  // Which each has for itself.
/// In a second, for streams that frames were dropped of.
constexpr std::size_t kDroppedTold = 8;
constexpr double kNoticeUs = 3;
constexpr TimeUs kTellLagUs = 1'000, kNoteEveryUs = 100'000, kTellPacedUs = 1'000'000;

}  // namespace

Subscriber::Subscriber(Context& context, Transport transport, GrantPtr grant, std::optional<control::Subscribe> first)
    : Connection(context, std::move(transport), std::move(grant),
                 {static_cast<std::size_t>(context.config.limits.max_control_bytes),
                  static_cast<std::size_t>(context.config.limits.max_control_bytes)}),
      first_(std::move(first)) {}

// It was not closed where the loop ends before it.
Subscriber::~Subscriber() {
  end_rewinds();
}

std::string Subscriber::label() const {
  return first_ ? "viewer of '" + first_->stream + "'" : "viewer";
}

void Subscriber::describe(ClientInfo& info) const {
  Connection::describe(info);
  info.kind = ClientInfo::Kind::kViewer;
  info.stream_count = streams_.size();
  for (const auto& [id, watched] : streams_) {
    if (info.streams.size() == ClientInfo::kMaxStreams) break;
    const Stream& stream = *watched.stream;
    info.streams.push_back({stream.name(), query_from_profile(stream.profile_of(*this)), watched.ladder.rung()});
  }
}

void Subscriber::on_open() {
  greet();
  if (first_) subscribe(*first_);
}

void Subscriber::on_message(const ControlMessage& message) {
  if (const auto* ack = std::get_if<control::Ack>(&message)) return acknowledge(*ack);
  if (const auto* request = std::get_if<control::Subscribe>(&message)) return subscribe(*request);
  if (const auto* request = std::get_if<control::Unsubscribe>(&message)) return unsubscribe(*request);
  if (const auto* request = std::get_if<control::TraceRequest>(&message)) {
    Stream* stream = context().hub.find(request->stream);
    if (stream == nullptr || stream->trace(*this, request->every)) return;
    return send(control::Notice{request->stream, "it is traced for as many viewers as may be: try again later", 0});
  }
  if (const auto* held = std::get_if<control::Prepared>(&message)) {
    if (Stream* stream = context().hub.find(held->stream)) stream->note_prepared(*this, held->asset);
    return;
  }
  if (const auto* what = std::get_if<control::Say>(&message)) return say(*what);
  if (const auto* late = std::get_if<control::Late>(&message)) return note_late(*late);
  if (const auto* wish = std::get_if<control::Enter>(&message)) return enter(*wish);
  if (const auto* floor = std::get_if<control::Floor>(&message)) return take(*floor);
  if (const auto* what = std::get_if<control::Leave>(&message)) return leave(*what);
  if (const auto* wanted = std::get_if<control::Seek>(&message)) return seek(*wanted);
  if (const auto* asked = std::get_if<control::History>(&message)) {
    const auto may = may_see_past(asked->stream);
    return tell_history(asked->stream, may ? nullptr : &may.error());
  }
  send_error(
      fail(ErrorCode::kUnsupported,
           "a viewer sends subscribe, unsubscribe, history, seek, prepared, trace_request, ack, late, enter, say, "
           "floor, leave, ping and pong"),
      {});
}

void Subscriber::on_binary(ByteView) {
  refuse(fail(ErrorCode::kInvalidArgument, "a viewer sends no binary messages: frames are sent to /v1/publish/STREAM"),
         {}, websocket::CloseCode::kUnknownData);
}

void Subscriber::subscribe(const control::Subscribe& request) {
  const auto answer = [&](const Error& error) { send_error(error, request.stream); };
  if (auto ok = check_stream_name(request.stream); !ok) return answer(ok.error());
  if (auto may = grant().may_subscribe(request.stream); !may) return answer(may.error());
  (void)end_rewind(request.stream);
  const auto limit = static_cast<std::size_t>(context().config.limits.max_streams_per_connection);
  Stream* known = context().hub.find(request.stream);
  const bool watched = known != nullptr && streams_.contains(known->id());
  if (!watched && streams_.size() >= limit) {
    return answer(fail(ErrorCode::kTooLarge, "this connection watches " + std::to_string(limit) +
                                                 " streams, the most that limits.max_streams_per_connection allows"));
  }
  if (auto taken = watched ? Result<void>() : grant().take_watched_stream(); !taken) return answer(taken.error());
  const auto charge = [this] { return grant().hold(Resource::kWaitingStream); };
  const auto stream = context().hub.open(request.stream, charge, holder());
  if (!stream) {
    if (!watched) grant().give_back(Resource::kStream);
    return answer(stream.error());
  }
  Watched& entry = streams_.try_emplace((*stream)->id(), Watched{*stream, Ladder(request.profile)}).first->second;
  if (auto watching = (*stream)->watch(*this, request.profile); !watching) {
    answer(watching.error());
    if (watched) return;  // It keeps its former profile.
    streams_.erase((*stream)->id());
    grant().give_back(Resource::kStream);
    return context().hub.unwatched(**stream);
  }
  entry.ladder = Ladder(request.profile);
  synchronise(entry, request.sync);
  context().hub.mark_dirty(**stream);
  if (!watched && may_see_past(request.stream)) tell_history(request.stream);
}

void Subscriber::unsubscribe(const control::Unsubscribe& request) {
  if (end_rewind(request.stream)) return;
  Stream* stream = context().hub.find(request.stream);
  const auto watched = stream != nullptr ? streams_.find(stream->id()) : streams_.end();
  if (watched != streams_.end()) synchronise(watched->second, {});
  if (stream == nullptr || streams_.erase(stream->id()) == 0) {
    return send_error(fail(ErrorCode::kNotFound, "this connection does not watch '" + request.stream + "'"),
                      request.stream);
  }
  grant().give_back(Resource::kStream);
  outbox().close_lane(stream->id());
  stream->unwatch(*this);
  context().hub.unwatched(*stream);
}

void Subscriber::synchronise(Watched& watched, const std::string& group) {
  if (watched.moment) context().moments.leave(*watched.moment);
  watched.moment.reset();
  watched.moment_told.reset();
  if (!group.empty()) watched.moment = context().moments.join(group, watched.stream->name());
  watched.is_waited_for = grant().may_speak(group).has_value();
  follow_beat();
}

Result<void> Subscriber::may_see_past(const std::string& stream) const {
  if (auto may = grant().may_subscribe(stream); !may) return may;
  if (auto may = grant().may_rewind(stream); !may) return may;
  if (context().history.keeps(stream)) return {};
  return fail(ErrorCode::kNotFound, "this broker keeps nothing of '" + stream + "' to be seen again: see [history]");
}

void Subscriber::tell_history(const std::string& stream, const Error* why) {
  control::History history{stream};
  double work_us = 0;
  if (why == nullptr || why->code != ErrorCode::kRefused)
    history = context().history.of(stream, steady_now_us(), &work_us);
  charge(work_us);
  if (why != nullptr) history.code = name_of(why->code);
  if (why != nullptr) history.message = why->message;
  send(history);
}

void Subscriber::seek(const control::Seek& wanted) {
  if (const auto sought = try_to_seek(wanted); !sought) tell_history(wanted.stream, &sought.error());
}

Result<void> Subscriber::try_to_seek(const control::Seek& wanted) {
  if (auto may = may_see_past(wanted.stream); !may) return may;
  if (const auto seen = rewind_of(wanted.stream)) {
    seen->seek(wanted);
    return {};
  }
  const Stream* stream = context().hub.find(wanted.stream);
  const auto watched = stream != nullptr ? streams_.find(stream->id()) : streams_.end();
  if (watched == streams_.end())
    return fail(ErrorCode::kNotFound, "this connection does not watch '" + wanted.stream + "': subscribe first");
  Shares& viewers = context().history.viewers;
  const std::int64_t max = context().config.history.max_viewers;
  if (!viewers.fits(holder(), 1, max)) {
    if (viewers.fits(holder(), 1, max, 1)) context().history.note_refused();
    return fail(ErrorCode::kRefused, std::to_string(viewers.used()) + " viewers see the past, and of the " +
                                         std::to_string(max) +
                                         " that history.max_viewers allows too few are free "
                                         "for one that holds more: try again later");
  }
  const auto rewind = std::make_shared<Rewind>(context(), static_cast<Rewind::Viewer&>(*this), wanted, holder(),
                                               watched->second.ladder.asked(), viewers.hold(holder(), 1));
  rewinds_.push_front(rewind);
  rewind->seek(wanted);
  return {};
}

std::shared_ptr<Rewind> Subscriber::rewind_of(const std::string& stream) const {
  for (const auto& rewind : rewinds_) {
    if (rewind->name() == stream) return rewind;
  }
  return nullptr;
}

bool Subscriber::end_rewind(const std::string& stream) {
  const auto rewind = rewind_of(stream);
  if (!rewind) return false;
  rewinds_.remove(rewind);
  rewind->stop();
  Stream* past = rewind->stream();
  if (past == nullptr || streams_.erase(past->id()) == 0) return false;
  grant().give_back(Resource::kStream);
  outbox().close_lane(past->id());
  past->unwatch(*this);
  return true;
}

bool Subscriber::show_past(Rewind& rewind, Stream* former) {
  const bool of_present = former == nullptr;
  if (of_present) former = context().hub.find(rewind.name());
  const auto watched = former != nullptr ? streams_.find(former->id()) : streams_.end();
  if (watched == streams_.end()) {  // Nothing any more: a stream that could not be watched again.
    (void)end_rewind(rewind.name());
    return false;
  }
  synchronise(watched->second, {});
  streams_.erase(watched);
  outbox().close_lane(former->id());
  former->unwatch(*this);
  if (of_present) context().hub.unwatched(*former);
  Stream& past = *rewind.stream();
  streams_.try_emplace(past.id(), Watched{&past, Ladder(rewind.profile())});
  if (auto watching = past.watch(*this, rewind.profile()); !watching) {
    refuse_seek(rewind, watching.error());
    show_present(rewind);
    return false;
  }
  context().hub.mark_dirty(past);
  return true;
}

void Subscriber::show_present(const Rewind& rewind) {
  const std::string name = rewind.name();
  const Profile wanted = rewind.wanted();
  if (end_rewind(name)) return subscribe({name, wanted});
  Stream* stream = context().hub.find(name);
  if (stream != nullptr && streams_.contains(stream->id())) send(stream->info_text(*this));
}

void Subscriber::refuse_seek(const Rewind& rewind, const Error& why) {
  const std::string name = rewind.name();
  tell_history(name, &why);
  if (rewind.stream() == nullptr && !rewind.is_seeking()) (void)end_rewind(name);
}

TimeUs Subscriber::pay(double work_us) {
  return grant().take_work(work_us, context().turn.now_us(), kForeverUs).value_or(0);
}

void Subscriber::note_late(const control::Late& late) {
  const Stream* stream = context().hub.find(late.stream);
  const auto watched = stream != nullptr ? streams_.find(stream->id()) : streams_.end();
  if (watched == streams_.end() || !watched->second.moment || !watched->second.is_waited_for) return;
  context().moments.report(*watched->second.moment, grant().holder(), late.lag_us, steady_now_us());
}

void Subscriber::note_arrival(const Stream& stream, std::span<const FramePtr> frames) {
  const auto watched = streams_.find(stream.id());
  if (watched == streams_.end() || !watched->second.moment) return;
  for (const FramePtr& frame : frames) {
    const TimeUs arrival_us = frame->times.arrival_us;
    if (!frame->envelope.is_key() || arrival_us < watched->second.noted_us + kNoteEveryUs) continue;
    watched->second.noted_us = arrival_us;
    context().moments.note_arrival(*watched->second.moment, arrival_us - frame->envelope.capture_us, arrival_us);
  }
}

double Subscriber::tell_moments() {
  double work_us = 0;
  for (auto& [id, watched] : streams_) {
    if (!watched.moment) continue;
    work_us += kMomentUs;
    const auto lag_us =
        context().moments.lag_us(*watched.moment, steady_now_us(), context().config.frames.max_sync_ms * 1000);
    if (!lag_us) continue;
    const TimeUs delay_us = context().moments.delay_us(*watched.moment);
    const auto& told = watched.moment_told;
    const auto is_near = [](TimeUs a, TimeUs b) { return std::abs(a - b) < kTellLagUs; };
    if (told && is_near(*lag_us, told->lag_us) && is_near(delay_us, told->delay_us)) continue;
    watched.moment_told = control::Moment{watched.stream->name(), *lag_us, delay_us};
    work_us += kNewsUs;
    send(*watched.moment_told);
  }
  return work_us;
}

void Subscriber::follow_beat() {
  synchronised_ = std::any_of(streams_.begin(), streams_.end(),
                              [](const auto& watched) { return watched.second.moment.has_value(); });
  if (rooms_.empty() && !synchronised_) return void(context().on_beat.erase(id()));
  context().on_beat.emplace(id(), this);
  context().arm_beat();
}

void Subscriber::enter(const control::Enter& wish) {
  if (const auto entered = try_to_enter(wish); !entered) refuse_in_room(entered.error(), wish.room);
}

Result<void> Subscriber::try_to_enter(const control::Enter& wish) {
  if (!context().config.rooms.enabled)
    return fail(ErrorCode::kUnsupported, "this broker has no rooms: see rooms.enabled");
  if (auto may = grant().may_subscribe(wish.room); !may) return may;
  if (rooms_.contains(wish.room)) {
    if (context().rooms.rename(wish, seat_in(wish.room))) return {};
    rooms_.erase(wish.room);  // Another connection has taken its place over.
  }
  if (rooms_.size() >= limits::kMaxRooms)
    return fail(ErrorCode::kTooLarge,
                "this connection is in " + std::to_string(limits::kMaxRooms) + " rooms, the most: leave one");
  const auto secret = new_resume_secret();
  if (!secret) return secret.error();
  const std::string& key = grant().identity().key;
  const std::string former = wish.resume.empty() ? std::string() : resume_proof(wish.resume, key);
  const bool speaks = grant().may_speak(wish.room).has_value();
  const auto seat = context().rooms.enter(wish, {holder(), resume_proof(*secret, key), former, speaks}, room_limits());
  if (!seat) return seat.error();
  rooms_.emplace(wish.room, *seat);
  follow_beat();
  control::Room answer;
  answer.room = wish.room;
  answer.self = seat->member;
  answer.resume = *secret;
  answer.speaks = speaks;
  send(answer);
  on_beat();
  return {};
}

void Subscriber::say(const control::Say& what) {
  auto may = grant().may_speak(what.room);
  if (may) may = context().rooms.say(what, seat_in(what.room), room_limits());
  if (!may) refuse_in_room(may.error(), what.room);
}

void Subscriber::take(const control::Floor& floor) {
  auto may = grant().may_speak(floor.room);
  if (may) may = context().rooms.take(floor, seat_in(floor.room));
  if (!may) refuse_in_room(may.error(), floor.room);
}

void Subscriber::leave(const control::Leave& what) {
  const auto found = rooms_.find(what.room);
  if (found == rooms_.end()) return;
  context().rooms.leave(what.room, found->second);
  rooms_.erase(found);
  follow_beat();
}

void Subscriber::on_beat() {
  guarded([this] {
    const TimeUs now_us = steady_now_us();
    if (outbox().control_messages() > 0 || is_closing() || now_us < news_due_us_) return;
    const auto pay = [&](double work_us) {
      if (work_us > 0) news_due_us_ = std::max(news_due_us_, now_us + grant().charge_news(work_us, now_us));
    };
    pay(tell_moments());
    for (std::size_t i = 0; i < rooms_.size() && std::max(news_due_us_, rooms_due_us_) <= now_us; ++i) {
      const auto& [room, seat] = *std::next(rooms_.begin(), static_cast<std::ptrdiff_t>(room_++ % rooms_.size()));
      pay(tell_room(room, seat));
    }
  });
}

double Subscriber::tell_room(const std::string& room, const Rooms::Seat& seat) {
  double work_us = 0, bytes = 0;
  for (const Outbox::Text& text : context().rooms.news(room, seat)) {
    bytes += static_cast<double>(text->size());
    work_us += kNewsUs;
    send(text);
  }
  note_work(work_us > 0 ? kWriteUs + bytes / kWrittenBytesPerUs : 0);
  const TimeUs now_us = steady_now_us();
  rooms_due_us_ = now_us + *news_bytes_.take(bytes, kNewsBytesPerS, kNewsBurst, now_us, kForeverUs);
  return work_us + bytes / kNewsBytesPerUs;
}

Rooms::Seat Subscriber::seat_in(const std::string& room) const {
  const auto found = rooms_.find(room);
  return found == rooms_.end() ? Rooms::Seat{} : found->second;
}

Rooms::Limits Subscriber::room_limits() {
  const auto& rooms = context().config.rooms;
  return {rooms.max_members, rooms.max_room_bytes, rooms.max_bytes};
}

void Subscriber::refuse_in_room(const Error& why, const std::string& room) {
  send(control::ErrorMessage{std::string(name_of(why.code)), why.message, {}, room});
}

void Subscriber::acknowledge(const control::Ack& ack) {
  for (const auto& item : ack.items) {
    outbox().acknowledge(item, steady_now_us());
    const auto found = streams_.find(item.stream_id);
    if (item.generation != 0 && found != streams_.end()) found->second.stream->note_held(*this, item.generation);
  }
  schedule_write();  // A window that it opened.
}

bool Subscriber::charge_poses(double work_us) {
  return grant().charge_poses(work_us, context().turn.now_us());
}

bool Subscriber::take_key(double work_us) {
  return grant().take_profile_key(work_us, context().turn.now_us());
}

void Subscriber::charge_key(double work_us) {
  if (work_us > 0) grant().charge_profile_key(work_us, context().turn.now_us());
}

void Subscriber::on_stream_changed(const Stream& stream, bool restart) {
  if (restart) outbox().open_lane(stream.id());
  send(stream.info_text(*this));
  on_memory(stream);
}

void Subscriber::on_memory(const Stream& stream) {
  const auto found = streams_.find(stream.id());
  const Generation* memory = stream.memory().get();
  if (found == streams_.end() || memory == nullptr || found->second.told == memory->number) return;
  send(stream.memory_text(memory->told_with(std::exchange(found->second.told, memory->number))));
}

void Subscriber::on_restart(const Stream& stream) {
  outbox().open_lane(stream.id());
  schedule_write();
}

void Subscriber::on_frames(const Stream& stream, std::span<const FramePtr> frames) {
  if (synchronised_) return deliver_noted(stream, frames);
  deliver(stream.id(), frames);
}

void Subscriber::deliver_noted(const Stream& stream, std::span<const FramePtr> frames) {
  note_arrival(stream, frames);
  deliver(stream.id(), frames);
}

FramePtr Subscriber::join_of(std::uint32_t stream_id) {
  const auto found = streams_.find(stream_id);
  if (found == streams_.end()) return nullptr;
  double work_us = 0;
  FramePtr join = found->second.stream->join_for(*this, &work_us);
  charge_output(work_us);
  return join;
}

void Subscriber::on_tick() {
  report_dropped();
  for (auto& [id, watched] : streams_) {
    if (is_closing()) break;
    if (context().config.frames.ladder) step(*watched.stream, watched.ladder);
    if (watched.stream->improve(*this)) context().hub.mark_dirty(*watched.stream);
  }
  schedule_write();
}

void Subscriber::on_paced(const std::string& limit) {
  const TimeUs now_us = steady_now_us();
  if (now_us < paced_told_us_ + kTellPacedUs) return;
  paced_told_us_ = now_us;
  const control::Notice notice{"", "what you send is read later: it is over " + limit + " of this broker", 0};
  send_droppable(websocket::framed(websocket::Opcode::kText, text_from_control(notice)));
}

void Subscriber::step(Stream& stream, Ladder& ladder) {
  const auto step = ladder.check(outbox().counts(stream.id()), stream.bands());
  if (!step) return;
  (void)stream.watch(*this, step->profile);  // Cannot fail: it watches already, and rungs are valid.
  context().hub.mark_dirty(stream);
  ++(step->down ? context().counters.ladder_down : context().counters.ladder_up)[step->rung];
  send(control::Notice{stream.name(), step->why + "; set frames.ladder on the broker to change that", 0});
}

void Subscriber::report_dropped() {
  const std::uint64_t joins = outbox().joins_total(), dropped_total = outbox().dropped_total();
  context().counters.joins_sent += joins - std::exchange(joins_counted_, joins);
  context().counters.frames_dropped += dropped_total - std::exchange(dropped_counted_, dropped_total);
  // A peer that does not read its queue gets no notice.
  if (outbox().control_messages() > 0) return;
  for (const Outbox::Dropped& dropped : outbox().take_dropped(kDroppedTold)) {
    const auto found = streams_.find(dropped.stream_id);
    if (found == streams_.end()) continue;
    charge(kNoticeUs);
    send(control::Notice{found->second.stream->name(),
                         "dropped " + std::to_string(dropped.frames) +
                             " frames that newer ones overtook before they could leave; where that goes on, a raw "
                             "profile, or fewer bands, needs less of the link",
                         dropped.frames});
  }
}

void Subscriber::end_rewinds() {
  while (!rewinds_.empty()) (void)end_rewind(std::string(rewinds_.front()->name()));
}

void Subscriber::on_closed() {
  report_dropped();
  end_rewinds();
  for (const auto& [room, seat] : std::exchange(rooms_, {})) context().rooms.leave(room, seat);
  context().on_beat.erase(id());
  for (const auto& [id, watched] : std::exchange(streams_, {})) {
    if (watched.moment) context().moments.leave(*watched.moment);
    watched.stream->unwatch(*this);
    context().hub.unwatched(*watched.stream);
  }
}

}  // namespace eigencast::broker
