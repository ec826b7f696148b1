// SPDX-License-Identifier: MIT
#include "broker/backbone/backbone.h"

#include <algorithm>
#include <cstdint>
#include <functional>
#include <limits>
#include <utility>

#include "broker/backbone/remote_memory.h"
#include "common/core/text.h"

namespace eigencast::broker {
namespace {

constexpr TimeUs kForever = std::numeric_limits<TimeUs>::max();
/// Retry delay after another broker changed the row first: its change is on its way.
constexpr TimeUs kOvertakenUs = 50'000;
constexpr TimeUs kForgetEveryUs = 10'000'000, kForgetMoreUs = 1'000'000;
constexpr std::uint64_t kEpochGaps = 256;
constexpr double kRowBytesPerUs = 28;  ///< JSON at its worst.
/// What heartbeats say.
constexpr char kAlive = '+', kStopped = '-', kAsksForRows = '?';

/// What comes before a frame in its message.
Bytes head_of(std::uint32_t epoch, std::uint64_t sequence) {
  Bytes head;
  ByteWriter out(head);
  out.u32(epoch);
  out.u64(sequence);
  return head;
}

}  // namespace

Backbone::Backbone(Settings settings, Link& link, AssetExchange& assets, Environment environment)
    : settings_(std::move(settings)),
      salt_(random_id(32)),
      link_(link),
      assets_(assets),
      environment_(std::move(environment)),
      directory_(settings_.id, environment_.now_us()),
      following_(&settings_, link, assets, &environment_, directory_, work_, totals_) {}

void Backbone::start(Hub& hub) {
  hub_ = &hub;
  following_.start(hub);
  link_.start(*this);
  const std::string alive = settings_.prefix + ".alive.";
  const auto heard = [this, alive](const std::string& subject, const Bytes& message) {
    const std::string broker = subject.substr(alive.size());
    const char says = message.size() == 1 ? static_cast<char>(message.front()) : 0;
    if (says == kStopped) return directory_.note_stopped(broker);
    if (says != kAlive && says != kAsksForRows) return;  // JetStream answers wherever a request asks it to.
    const TimeUs now = environment_.now_us();
    if (directory_.has_streams(broker) && !directory_.is_alive(broker, now)) following_.note_all();
    directory_.note_heartbeat(broker, now);
    rows_asked_ = rows_asked_ || (says == kAsksForRows && broker != settings_.id);
  };
  listening_ = {link_.subscribe(alive + ">", heard),
                link_.serve(settings_.prefix + ".joins." + settings_.id,
                            [this](Bytes request, Link::Reply reply) { answer_join(request, reply); })};
  assets_.serve(settings_.id);
}

void Backbone::stop() {
  if (hub_ == nullptr) return;
  for (auto& [name, own] : own_) {
    own.entry.live = false;
    write(name, own.entry);
  }
  link_.publish(settings_.prefix + ".alive." + settings_.id, {kStopped});
  link_.stop();
  assets_.stop();
  listening_.clear();
  following_.stop();
  own_.clear();
  claims_.clear();
  hub_ = nullptr;
}

void Backbone::tick() {
  if (hub_ == nullptr) return;
  send_heartbeat(table_read_ ? kAlive : kAsksForRows);
  tell_rows();
  following_.tick();
  reconcile();
}

void Backbone::send_heartbeat(char text) {
  const TimeUs now = environment_.now_us();
  if (!connected_ || now < next_heartbeat_us_) return;
  const bool each_time = !own_.empty() || !claims_.empty() || !table_read_;
  next_heartbeat_us_ = now + settings_.heartbeat_every_us * (each_time ? 1 : directory_.heartbeat_periods());
  link_.publish(settings_.prefix + ".alive." + settings_.id, {static_cast<std::uint8_t>(text)});
}

/// Brokers that start or return while the table does not answer learn the streams from their owners.
void Backbone::tell_rows() {
  const TimeUs now = environment_.now_us();
  if (!rows_asked_ || !connected_ || now < next_rows_us_) return;
  rows_asked_ = false;
  next_rows_us_ = now + settings_.heartbeat_every_us;
  for (const auto& [name, own] : own_) {
    const Directory::Known* known = directory_.find(name);
    const bool written = known != nullptr && known->entry == own.entry;
    if (written) link_.publish_row(token_from_stream(name), text_from_entry(*known->entry), known->revision);
  }
}

void Backbone::on_connected() {
  connected_ = true;
  table_read_ = false;
  last_error_.clear();
  next_heartbeat_us_ = 0;
  directory_.restart_listening(environment_.now_us());
  send_heartbeat(kAlive);
}

void Backbone::on_disconnected(const std::string& why) {
  if (connected_) {
    ++totals_.disconnects;
    environment_.warn("lost, " + why + "; streams of this broker go on, those of others stand still");
  } else if (last_error_ != why) {
    environment_.warn("not connected, " + why + "; streams of this broker only, trying again");
  }
  last_error_ = why;
  connected_ = table_read_ = false;
  reconcile();
}

void Backbone::on_new_table() {
  table_read_ = false;
  directory_.restart();
}

void Backbone::on_table_read() {
  table_read_ = true;
  directory_.end_reading();
  std::erase_if(writing_, [](const auto& item) { return item.second != kForever; });
  following_.note_all();
  for (const auto& [name, own] : own_) unsettled_.insert(name);
  for (const auto& [name, known] : directory_.streams()) {
    if (known.entry && known.entry->owner == settings_.id) unsettled_.insert(name);
  }
  environment_.inform("connected, " + std::to_string(directory_.streams().size()) + " streams are known");
  reconcile();
}

void Backbone::on_row(const std::string& key, std::optional<std::string> text, std::uint64_t revision,
                      const std::string& from) {
  const auto name = stream_from_token(key);
  if (!name) return;
  const double work_us = 1 + static_cast<double>(text ? text->size() : 0) / kRowBytesPerUs;
  if (!from.empty() && !work_.take_row(from, work_us, environment_.now_us())) {
    return environment_.warn("rows of broker " + from + " are left out: they take too much computing");
  }
  if (auto taken = directory_.take(*name, text, revision, environment_.now_us(), from); !taken) {
    return environment_.warn("stream '" + *name + "': " + taken.error().message);
  }
  const Directory::Known* known = directory_.find(*name);
  // Rows are forgotten in time; epochs grow all the same.
  if (known != nullptr && known->entry) environment_.note_epoch(known->entry->epoch);
  note(*name);
  // The rest waits for the next tick.
  const bool used_here = own_.contains(*name) || claims_.contains(*name) || hub_->find(*name) != nullptr;
  if (table_read_ && used_here) reconcile();
}

void Backbone::reconcile() {
  // Callbacks from below may re-enter.
  if (hub_ == nullptr || std::exchange(reconciling_, true)) return;
  reconcile_claims();
  for (const std::string& name : std::exchange(unsettled_, {})) reconcile_own(name);
  following_.reconcile(connected_, table_read_);
  forget();
  reconciling_ = false;
}

void Backbone::reconcile_claims() {
  std::vector<std::string> names;
  for (const auto& [name, claim] : claims_) names.push_back(name);
  for (const std::string& name : names) try_claim(name);
}

void Backbone::reconcile_own(const std::string& name) {
  if (claims_.contains(name)) return;  // Notes it again when it ends.
  const Directory::Known* known = directory_.find(name);
  const auto own = own_.find(name);
  if (own == own_.end()) {  // Perhaps an entry of this broker whose stream has ended.
    if (known == nullptr || !known->entry || !known->entry->live || known->entry->owner != settings_.id) return;
    unsettled_.insert(name);
    DirectoryEntry entry = *known->entry;
    entry.live = false;
    return write(name, entry);
  }
  const DirectoryEntry* holder = directory_.live(name, environment_.now_us());
  if (holder != nullptr && holder->owner != settings_.id && yields_to(own->second.entry, *holder)) {
    ++totals_.senders_evicted;
    environment_.warn("stream '" + name + "': its sender is at another broker now, the one here is sent away");
    if (Stream* stream = hub_->find(name)) following_.follow(*stream, DirectoryEntry(*holder));
    return;
  }
  if (known != nullptr && known->entry == own->second.entry) return;
  unsettled_.insert(name);
  write(name, own->second.entry);
}

/// Its row, or what is here of the stream, has changed.
void Backbone::note(const std::string& name) {
  unsettled_.insert(name);
  following_.note(name);
}

/// Removes entries of brokers that stopped long ago, and of streams that ended here.
void Backbone::forget() {
  const TimeUs now = environment_.now_us();
  if (now < next_forget_us_) return;
  directory_.forget_silent(now);
  const std::vector<std::string> names = directory_.forgotten(now);
  next_forget_us_ = now + (names.size() < Directory::kMaxForgotten ? kForgetEveryUs : kForgetMoreUs);
  for (const std::string& name : names) write(name, std::nullopt);
}

void Backbone::claim(const std::string& stream, const control::Announce& announce, const Resume& resume,
                     Granted granted) {
  claims_[stream] = {++last_claim_, announce, resume, std::move(granted), environment_.now_us()};
  next_heartbeat_us_ = 0;  // Other brokers must know that this one is alive before they see the claim.
  send_heartbeat(kAlive);
  try_claim(stream);
}

std::uint32_t Backbone::epochs_before(const std::string& name) const {
  const Directory::Known* known = directory_.find(name);
  const Stream* stream = hub_->find(name);
  // A row is forgotten in time; what viewers here have seen is not.
  const std::uint32_t of_row = known != nullptr && known->entry ? known->entry->epoch : 0;
  // A row may end at kMaxForeignEpoch; one above it would be believed by nobody.
  return std::max(of_row < kMaxForeignEpoch ? of_row : 0, stream != nullptr ? stream->epoch() : 0);
}

Result<std::uint32_t> Backbone::next_epoch(const std::string& stream) {
  return environment_.next_epoch(epochs_before(stream));
}

void Backbone::try_claim(const std::string& name) {
  const auto found = claims_.find(name);
  if (found == claims_.end()) return;
  const TimeUs now = environment_.now_us();
  const DirectoryEntry* holder = directory_.live(name, now);
  const Resume& resume = found->second.resume;
  const bool others =
      holder != nullptr && holder->owner != settings_.id && !is_same_proof(resume.shown, holder->resume);
  if (others && connected_ && !environment_.replaces()) {
    ++totals_.claims_refused;
    return grant(name, fail(ErrorCode::kRefused, "stream '" + name +
                                                     "' already has a sender, at another broker, and a stream has one "
                                                     "at a time: stop that one, or publish under another name"));
  }
  const Stream* stream = hub_->find(name);
  const std::string sender = stream != nullptr ? sender_of(stream->holder(), salt_) : "";
  // Its broker may have given its sender the epoch that is to follow, of which the row says nothing yet.
  const Directory::Known* known = directory_.find(name);
  const bool changes = known != nullptr && known->entry && !known->entry->next.empty();
  const std::uint32_t above = epochs_before(name) + (changes ? 1 : 0);
  if (!connected_ || now - found->second.since_us >= settings_.claim_timeout_us) {
    if (connected_) environment_.warn("stream '" + name + "': the directory does not answer, granted without it");
    return grant(name, epoch_apart(above));
  }
  if (!may_write(name)) return;
  const auto epoch = environment_.next_epoch(above);
  if (!epoch) return grant(name, epoch.error());
  write(name, DirectoryEntry{settings_.id, *epoch, true, found->second.announce, resume.issued, sender},
        [this, name, epoch, number = found->second.number](const Result<std::uint64_t>& written) {
          const auto still = claims_.find(name);
          if (written && still != claims_.end() && still->second.number == number) grant(name, *epoch);
        });
}

/// Without the directory: other brokers that know as little seldom give the same one.
Result<std::uint32_t> Backbone::epoch_apart(std::uint32_t above) const {
  const std::uint64_t gap = std::hash<std::string>{}(settings_.id) % kEpochGaps;
  const auto own = environment_.next_epoch(above);
  if (!own) return own;
  return environment_.next_epoch(static_cast<std::uint32_t>(std::min<std::uint64_t>(*own + gap, UINT32_MAX - 1)));
}

void Backbone::grant(const std::string& name, Result<std::uint32_t> epoch) {
  const auto found = claims_.find(name);
  if (found == claims_.end()) return;
  const Granted granted = std::move(found->second.granted);
  claims_.erase(found);
  note(name);  // The sender may have disconnected.
  granted(std::move(epoch));
}

bool Backbone::may_write(const std::string& name) const {
  if (!connected_ || !table_read_) return false;
  const auto found = writing_.find(name);
  return found == writing_.end() || environment_.now_us() >= found->second;
}

void Backbone::write(const std::string& name, const std::optional<DirectoryEntry>& entry,
                     std::function<void(const Result<std::uint64_t>&)> written) {
  if (!may_write(name)) return;
  writing_[name] = kForever;
  std::optional<std::string> text;
  if (entry) text = text_from_entry(*entry);
  link_.write_row(token_from_stream(name), text, directory_.revision(name),
                  [this, name, text, written = std::move(written)](const Result<std::uint64_t>& result) {
                    if (hub_ == nullptr) return;
                    if (result) {
                      writing_.erase(name);
                      // Cannot fail: the text was just generated.
                      (void)directory_.take(name, text, *result, environment_.now_us(), settings_.id);
                    } else {
                      const bool overtaken = result.error().code == ErrorCode::kRefused;
                      writing_[name] = environment_.now_us() + (overtaken ? kOvertakenUs : settings_.retry_us);
                      if (overtaken) directory_.drop_removed(name);
                    }
                    if (written) written(result);
                  });
}

void Backbone::on_announced(const Stream& stream) {
  if (following_.feeds(stream.name())) return;
  note(stream.name());
  DirectoryEntry entry{settings_.id,          stream.epoch(),  true,
                       stream.announcement(), stream.resume(), sender_of(stream.holder(), salt_)};
  const std::string frames = settings_.prefix + ".frames." + settings_.id + "." + token_from_stream(stream.name());
  own_[stream.name()] = {std::move(entry), stream.layout(), frames, nullptr, {}, {stream.epoch()}};
}

/// Brokers that have the memory get the sender's keys, all others keys that need none.
void Backbone::on_key(const Stream& stream, const KeyRecordPtr& sent) {
  const auto found = own_.find(stream.name());
  if (found == own_.end()) return;
  Own& own = found->second;
  const KeyRecordPtr& record = stream.plain();
  own.newest = record;
  own.join.clear();
  if (!connected_) return;
  if (own.memory.root != 0) publish_recalled(own, stream, *sent);
  link_.publish(own.frames, record->frame(head_of(stream.epoch(), record->sequence)), stream.holder().key);
  ++totals_.frames_published;
}

/// Before the other chain's key: a broker that changes over to a join has not had its pose yet.
void Backbone::publish_recalled(Own& own, const Stream& stream, const KeyRecord& record) {
  Bytes head = head_of_recalled(*stream.memory(), record.generation, stream.epoch(), record.sequence);
  if (!std::exchange(own.wants_join, false)) {
    link_.publish(subject_of_memory(own.frames), record.frame(std::move(head)), stream.holder().key);
  } else if (auto join = record.join_frame(own.layout, std::move(head))) {
    link_.publish(subject_of_memory(own.frames), *std::move(join), stream.holder().key);
    ++totals_.joins_encoded;
  }
}

void Backbone::on_memory(const Stream& stream) {
  const auto found = own_.find(stream.name());
  if (found == own_.end()) return;
  const Generation* memory = stream.memory().get();
  MemoryNotice& notice = found->second.memory = {stream.epoch(), 0, stream.share()->generations};
  if (memory != nullptr) {
    notice.root = memory->root;
    notice.number = memory->number;
    for (const auto& segment : memory->segments) notice.segments.push_back(*Sha256::from_hex(segment.id));
  }
  if (connected_) link_.publish(subject_of_memory(found->second.frames), bytes_from(notice), stream.holder().key);
}

void Backbone::on_next(const Stream& stream) {
  const auto found = own_.find(stream.name());
  if (found == own_.end()) return;
  const NextPtr& next = stream.snapshot().next;
  std::string asset = next ? next->asset : "";
  if (found->second.entry.next == asset) return;
  found->second.entry.next = std::move(asset);
  note(stream.name());
}

void Backbone::on_stalled(const Stream& stream) {
  note(stream.name());
  own_.erase(stream.name());
}

void Backbone::on_forgotten(const Stream& stream) {
  note(stream.name());
  own_.erase(stream.name());
  following_.forget_stream(stream.name());
}

void Backbone::answer_join(ByteView request, const Link::Reply& reply) {
  ByteReader in(request);
  const std::uint32_t epoch = in.u32();
  const ByteView rest = in.bytes(in.remaining());
  std::string name(rest.begin(), rest.end());
  const bool of_memory = name.ends_with('=');
  if (of_memory) name.pop_back();
  const auto found = own_.find(name);
  if (in.failed() || found == own_.end() || found->second.entry.epoch != epoch) return reply({});
  if (of_memory) {
    found->second.wants_join = found->second.memory.root != 0;
    return reply(bytes_from(found->second.memory));
  }
  if (!found->second.newest) return reply({});
  if (found->second.join.empty()) {
    const KeyRecord& newest = *found->second.newest;
    if (!store(found->second.join, newest.join_frame(found->second.layout, head_of(epoch, newest.sequence)))) {
      return reply({});
    }
    ++totals_.joins_encoded;
  }
  ++totals_.joins_answered;
  reply(found->second.join);
}

Backbone::Totals Backbone::totals() const {
  Totals totals = totals_;
  totals.connected = connected_;
  totals.brokers = directory_.brokers(environment_.now_us());
  totals.streams_subscribed = following_.size();
  const TimeUs now = environment_.now_us();
  totals.streams_known = static_cast<std::uint64_t>(
      std::count_if(directory_.streams().begin(), directory_.streams().end(),
                    [&](const auto& item) { return directory_.live(item.first, now) != nullptr; }));
  totals.asset_bytes_fetched = assets_.fetched_bytes();
  return totals;
}

std::string Backbone::status() const {
  if (!connected_) return "backbone lost" + (last_error_.empty() ? std::string() : ": " + last_error_);
  return std::to_string(totals().brokers) + " brokers";
}

}  // namespace eigencast::broker
