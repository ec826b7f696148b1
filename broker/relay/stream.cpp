// SPDX-License-Identifier: MIT
#include "broker/relay/stream.h"

#include <algorithm>
#include <cassert>
#include <utility>

#include "broker/relay/outbox.h"
#include "broker/relay/profile_budget.h"
#include "broker/websocket/protocol.h"
#include "common/wire/limits.h"

namespace eigencast::broker {
namespace {

/// Makes profiles that request the same frames equal, whatever the epoch's format.
Profile canonical(Profile profile) {
  if (profile.rate == Profile::Rate::kRaw) {
    profile.k = Profile{}.k;
    profile.scheme = Profile{}.scheme;
  }
  return profile;
}

// What the codec takes on one core of 2026, rounded up: 16 us for a key of 180 bytes (bench/codec_rate.cpp); for one of
// few bytes that changes most of 32,768 coefficients 275 us, from a memory 400, to code it anew 590.
constexpr double kDecodedPerUs = 120, kDecodedBytesPerUs = 8, kFloatsPerUs = 450, kFloatBytesPerUs = 2000;
constexpr double kRecalledPerUs = 250, kCodedAnewPerUs = 85;  ///< Besides decoding; besides encoding_us().

// Asked to pay for a pose, at most: a crowd that cannot must not cost more than the pose.
constexpr std::size_t kMaxPayersAsked = 8;
// What a key costs a profile besides poses: pacing, cutting bands.
constexpr double kProfileKeyUs = 5, kProfileKeyBytesPerUs = 2'000;
constexpr double kOfferedUs = 0.25;      ///< A frame and a viewer, with what brings it to the socket.
constexpr TimeUs kRetryUs = 50'000;      ///< After a key that nobody paid for.
constexpr double kTraceUs = 2;           ///< A viewer that is told one.
constexpr std::int64_t kMaxTraced = 64;  ///< Viewers of a stream that are told any, as its sender pays.
constexpr double kBeginAnewUs = 10;      ///< A viewer: it is told, and its chain begins anew.
constexpr double kChangeChainUs = 5;     ///< A viewer that gains or lacks what keys need.

}  // namespace

void StreamShare::announce() {
  const std::lock_guard lock(mutex);
  announced = true;
  charge.reset();
}

void StreamShare::begin_preparing(const std::string& asset) {
  const std::lock_guard lock(mutex);
  to_prepare = asset;
  prepared_by.clear();
}

void StreamShare::note_prepared(const std::string& asset, const std::string& holder, std::int64_t viewers) {
  const std::lock_guard lock(mutex);
  if (asset == to_prepare && (prepared_by[holder] += viewers) <= 0) prepared_by.erase(holder);
}

bool StreamShare::is_prepared() {
  const std::lock_guard lock(mutex);
  const auto viewers = watchers.all();
  const auto ready = std::count_if(viewers.begin(), viewers.end(), [&](const auto& holder) {
    const auto found = prepared_by.find(holder.first);
    return found != prepared_by.end() && 10 * found->second >= 9 * holder.second;
  });
  return 10 * ready >= 9 * std::ssize(viewers);
}

Result<std::shared_ptr<void>> StreamShare::take_place(const std::string& holder, std::uint32_t max) {
  const std::lock_guard lock(mutex);
  if (watchers.fits(holder, 1, max)) return watchers.hold(holder, 1);
  return fail(ErrorCode::kTooLarge, "this stream has " + std::to_string(watchers.used()) + " watchers, and of the " +
                                        std::to_string(max) + " that limits.max_subscribers_per_stream allows too " +
                                        "few are free for one that holds more: try again later");
}

std::shared_ptr<StreamShare> StreamIds::new_share() {
  const std::lock_guard lock(slots_->mutex);
  auto& [mutex, last_tags, free] = *slots_;
  if (free.empty()) {
    if (last_tags.size() == max_ids_) return nullptr;
    last_tags.push_back(0);
    free.insert(static_cast<std::uint32_t>(last_tags.size()));
  }
  const std::uint32_t id = free.extract(free.begin()).value();
  return {new StreamShare(id, last_tags[id - 1]), [slots = slots_](StreamShare* share) {
            const std::lock_guard slots_lock(slots->mutex);
            slots->last_tags[share->id - 1] = share->tag;
            slots->free.insert(share->id);
            delete share;
          }};
}

Result<std::shared_ptr<void>> StreamIds::pay(const Charge& charge, const std::string& holder) {
  if (!waiting_.fits(holder, 1, max_waiting_)) {
    return fail(ErrorCode::kTooLarge, std::to_string(waiting_.used()) +
                                          " streams are watched that nobody sends, and of limits.max_waiting_streams " +
                                          "too few are free for one that watches more: try again later");
  }
  const auto paid = charge();
  if (!paid) return paid;
  return std::shared_ptr<void>(paid->get(), [paid = *paid, counted = waiting_.hold(holder, 1)](void*) {});
}

Result<std::shared_ptr<StreamShare>> StreamIds::of(std::string_view name, const Charge& charge,
                                                   const std::string& holder) {
  const std::lock_guard lock(mutex_);
  const auto found = shares_.find(name);
  auto share = found == shares_.end() ? nullptr : found->second.lock();
  const bool is_new = !share;
  if (is_new && !(share = new_share()))
    return fail(ErrorCode::kTooLarge, "all " + std::to_string(max_ids_) + " stream ids are in use: stop a stream");
  const std::lock_guard share_lock(share->mutex);
  if (charge && !share->announced && !share->charge) {
    if (auto stored = store(share->charge, pay(charge, holder)); !stored) return stored.error();
  }
  if (!is_new) return share;
  if (shares_.size() >= sweep_at_) {
    std::erase_if(shares_, [](const auto& item) { return item.second.expired(); });
    sweep_at_ = 2 * shares_.size() + 64;
  }
  shares_.insert_or_assign(std::string(name), share);
  return share;
}

Stream::Stream(std::string name, std::shared_ptr<StreamShare> share, const Settings& settings)
    : name_(std::move(name)), share_(std::move(share)), settings_(settings) {}

Stream::~Stream() {
  watched_.clear();
  for (StreamTap* tap : settings_.taps) tap->on_forgotten(*this);
}

control::StreamInfo::State Stream::state() const {
  if (present_.epoch == 0) return control::StreamInfo::State::kWaiting;
  return present_.live ? control::StreamInfo::State::kLive : control::StreamInfo::State::kStalled;
}

Result<void> Stream::claim(PublisherLink& link, bool replace) {
  if (publisher_ != nullptr && (replace || publisher_->yields())) {
    PublisherLink* before = publisher_;
    release(*before);
    before->on_replaced();
  }
  if (publisher_ != nullptr) {
    return fail(ErrorCode::kRefused,
                "stream '" + name_ +
                    "' already has a sender, and a stream has one at a time: stop that one, or publish "
                    "under another name");
  }
  publisher_ = &link;
  resume_.clear();
  return {};
}

void Stream::release(PublisherLink& link) {
  if (publisher_ != &link) return;
  publisher_ = nullptr;
  stall();
  report_count();
}

void Stream::stall() {
  coming_.reset();
  present_.next.reset();
  if (!std::exchange(present_.live, false)) return;
  info_texts_.clear();
  deliver();
  for (StreamTap* tap : settings_.taps) tap->on_stalled(*this);
  for (Watcher* watcher : order_) watcher->on_stream_changed(*this, false);
}

Result<void> Stream::announce(const control::Announce& announce, std::uint32_t epoch, const std::string& resume) {
  resume_ = resume;
  auto begun = restore({announce, epoch, true, nullptr, ++share_->tag});
  if (begun) report_count();
  return begun;
}

void Stream::prepare(NextPtr next) {
  if (next) share_->begin_preparing(next->asset);
  set_next(std::move(next));
}

void Stream::set_next(NextPtr next) {
  deliver();
  coming_.reset();
  for (auto& [watcher, watched] : watched_) watched.prepared = false;
  present_.next = std::move(next);
  info_texts_.clear();
  for (StreamTap* tap : settings_.taps) tap->on_next(*this);
  if (present_.epoch == 0) return;
  for (Watcher* watcher : order_) watcher->on_stream_changed(*this, false);
}

bool Stream::is_prepared(TimeUs waited_us) const {
  if (waited_us >= kMostPrepareUs) return true;
  return waited_us >= settings_.min_prepare_us && share_->is_prepared();
}

Result<std::uint8_t> Stream::announce_next(const control::Announce& announce, std::uint32_t epoch,
                                           const std::string& resume) {
  if (const auto codec = codec_from_name(announce.format.codec); !codec) return codec.error();
  coming_ = Coming{{announce, epoch, true, nullptr, ++share_->tag}, resume};
  return coming_->snapshot.tag;
}

void Stream::note_prepared(const Watcher& watcher, const std::string& asset) {
  const auto found = watched_.find(&watcher);
  if (found == watched_.end() || !present_.next || present_.next->asset != asset) return;
  if (!std::exchange(found->second.prepared, true)) share_->note_prepared(asset, watcher.holder(), 1);
}

Result<void> Stream::restore(const Snapshot& snapshot) {
  assert(snapshot.epoch >= present_.epoch);
  deliver();
  coming_.reset();
  // The one before gives its pace to the one that continues it.
  const bool continues = snapshot.announced.continues && present_.epoch != 0 && snapshot.epoch != present_.epoch;
  const bool keeps_next = snapshot.next && present_.next && *snapshot.next == *present_.next;
  if (snapshot.epoch != 0) {
    const StreamFormat& format = snapshot.announced.format;
    const auto codec = codec_from_name(format.codec);
    if (!codec) return codec.error();
    present_ = snapshot;
    info_texts_.clear();
    memory_texts_.clear();
    share_->announce();
    layout_ = {*codec, format.rows, format.channels, format.band_ends};
    for (StreamTap* tap : settings_.taps) tap->on_announced(*this);
    plain_.reset();
    const auto former = std::exchange(groups_, {});
    for (Watcher* watcher : order_) {
      Watched& watched = watched_.at(watcher);
      watched.prepared &= keeps_next;
      const Group* group = std::exchange(watched.group, nullptr);
      join_group(*watcher, watched, continues && group != nullptr ? &group->feed : nullptr);
    }
  }
  awaits_snapshot_ = false;
  for (Watcher* watcher : order_) watcher->on_stream_changed(*this, true);
  return {};
}

Result<void> Stream::add_frame(ByteView message, TimeUs now_us) {
  auto taken = take_frame(message, now_us);
  if (taken) deliver();
  return taken;
}

Result<void> Stream::take_frame(ByteView message, TimeUs now_us) {
  if (!present_.live) return fail(ErrorCode::kCorrupt, "a frame came before 'announce': announce the surface first");
  const auto frame = parse_frame(message);
  if (!frame) return frame.error();
  if (coming_ && frame->envelope.tag == coming_->snapshot.tag) {
    resume_ = coming_->resume;
    const Snapshot begins = std::move(coming_->snapshot);
    if (auto begun = restore(begins); !begun) return begun;
    unpaid_us_ += kBeginAnewUs * watchers();
  }
  if (frame->envelope.tag != present_.tag)
    return fail(ErrorCode::kCorrupt, "tag " + std::to_string(frame->envelope.tag) + " is not that of 'announced', " +
                                         std::to_string(present_.tag) + ": wait for it before the first frame");
  return take_frame(*frame, now_us);
}

Result<void> Stream::take_frame(const WireFrame& frame, TimeUs now_us) {
  if (!frame.envelope.is_key()) return fail(ErrorCode::kCorrupt, "a sender sends keys and joins only");
  const KeyRecordPtr& newest = present_.newest;
  const ChainClock clock = newest ? newest->clock() : ChainClock{};
  const auto whole = resolved(frame, newest ? &clock : nullptr, present_.epoch);
  if (!whole)
    return fail(ErrorCode::kCorrupt, newest ? "a key must follow the one before it (newest is " +
                                                  std::to_string(newest->sequence) + " at " +
                                                  std::to_string(newest->capture_us) + " us): send a join after a gap"
                                            : "the first frame after 'announce' must be a join");
  const auto record = record_from(*whole, now_us);
  if (!record) return in_context("frame " + std::to_string(whole->envelope.sequence), record.error());
  if (whole->envelope.is_recalled()) unpaid_us_ += static_cast<double>(layout_.size()) / kRecalledPerUs;
  take_record(*record, now_us);
  return {};
}

void Stream::set_memory(GenerationPtr memory) {
  deliver();
  const bool goes_on = memory && present_.memory && memory->root == present_.memory->root;
  present_.memory = std::move(memory);
  memory_texts_.clear();
  for (StreamTap* tap : settings_.taps) tap->on_memory(*this);
  if (!goes_on && present_.newest && present_.newest->after->phase) {
    KeyRecord newest = *present_.newest;
    ChainState after = *newest.after;
    after.phase.reset();
    newest.after = std::make_shared<const ChainState>(std::move(after));
    present_.newest = std::make_shared<const KeyRecord>(std::move(newest));
  }
  if (!goes_on && std::exchange(present_.used, 0) != 0) {
    groups_.clear();
    for (Watcher* watcher : order_) {
      join_group(*watcher, watched_.at(watcher));
      watcher->on_restart(*this);
    }
  }
  if (!present_.memory) return;
  for (Watcher* watcher : order_) watcher->on_memory(*this);
}

const KeyRecordPtr& Stream::plain(double* work_us) const {
  const KeyRecordPtr& newest = present_.newest;
  if (plain_ && newest && plain_->sequence == newest->sequence) return plain_;
  // A chain that begins with the sender's state goes on as the sender's.
  if (!newest || (present_.used == 0 && (!plain_ || plain_->join))) return newest;
  const bool follows = present_.used != 0 && plain_ && newest->before && plain_->sequence + 1 == newest->sequence;
  plain_ = plain_record(layout_, *newest, follows ? plain_.get() : nullptr);
  (work_us != nullptr ? *work_us : unpaid_us_) +=
      encoding_us(layout_, plain_->payload.size()) + static_cast<double>(layout_.size()) / kCodedAnewPerUs;
  return plain_;
}

void Stream::note_held(Watcher& watcher, std::uint32_t generation) {
  const auto found = watched_.find(&watcher);
  const Generation* memory = present_.memory.get();
  if (found == watched_.end() || memory == nullptr || generation > memory->number ||
      generation < std::max(memory->root, found->second.generation))
    return;
  found->second.generation = generation;
  // Who comes and goes must not use up the sender's time.
  change_chain(watcher, generation > found->second.came_to);
}

void Stream::change_chain(Watcher& watcher, bool sender_pays) {
  Watched& watched = watched_.at(&watcher);
  if (watched.group == nullptr || watched.group->plain == needs_plain(watched)) return;
  deliver();
  if (sender_pays) unpaid_us_ += kChangeChainUs;
  leave_group(watcher, watched);
  join_group(watcher, watched);
  watcher.on_restart(*this);
}

void Stream::take_record(const KeyRecordPtr& record, TimeUs now_us) {
  if (record->generation > present_.used) {
    present_.used = record->generation;
    for (Watcher* watcher : order_) change_chain(*watcher, true);
  }
  present_.newest = record;
  ++keys_received_;
  unpaid_us_ += Outbox::kOfferUs * watchers();
  tracer_.note_key(record->sequence, record->arrival_us);
  for (StreamTap* tap : settings_.taps) tap->on_key(*this, present_.newest);
  for (auto& [key, group] : groups_) group->add_key(*this, now_us);
  has_pending_ = true;
}

Result<KeyRecordPtr> Stream::record_from(const FrameView& frame, TimeUs now_us) const {
  const Envelope& head = frame.envelope;
  const KeyRecordPtr& newest = present_.newest;
  if ((head.flags & ~Envelope::kRecalled) != 0)
    return fail(ErrorCode::kCorrupt, "a sender's frames carry no flags but that of its memory");
  const Generation* memory = present_.memory.get();
  if (head.is_recalled() && memory == nullptr)
    return fail(ErrorCode::kCorrupt, "it needs a memory that this broker does not hold: wait for 'remembered'");
  if (!layout_.all_bands().includes(head.bands) || !head.bands.has(0)) {
    return fail(ErrorCode::kCorrupt, "bands must be among those announced and include band 0");
  }
  if (newest && head.sequence <= newest->sequence) {
    return fail(ErrorCode::kCorrupt, "sequence must grow (newest is " + std::to_string(newest->sequence) + ")");
  }
  if (newest && head.capture_us <= newest->capture_us) {
    return fail(ErrorCode::kCorrupt,
                "capture time must grow (newest is " + std::to_string(newest->capture_us) + " us)");
  }
  const bool join = head.kind == FrameKind::kJoin;
  std::uint8_t half_spacing = newest ? newest->half_spacing : 0;
  std::shared_ptr<const ChainState> before, after;
  if (join) {
    auto state = decode_join(layout_, head.bands, frame.payload, head.is_recalled());
    if (!state) return state.error();
    if (state->phase && !memory->poses.has(*state->phase))
      return fail(ErrorCode::kCorrupt, "a phase that its memory does not have");
    state->age_us = head.age_us;
    const bool follows = newest && head.sequence == newest->sequence + 1;
    if (follows && head.age_us == head.capture_us - newest->capture_us && state->older == newest->after->newer)
      before = newest->after;
    // The older key stands for the last one of the epoch before.
    if (!newest && present_.announced.continues && head.age_us > 0)
      before = std::make_shared<const ChainState>(advanced(std::nullopt, Key(state->older), 0));
    after = std::make_shared<const ChainState>(std::move(*state));
  } else {
    const ChainState& state = *newest->after;
    std::optional<std::uint32_t> phase;
    auto key = [&]() -> Result<Key> {
      if (!head.is_recalled()) return decode_key(layout_, head.bands, state, frame.payload);
      auto recalled = decode_recalled_key(layout_, head.bands, state, memory->poses, frame.payload);
      if (!recalled) return recalled.error();
      phase = recalled->phase;
      return std::move(recalled->key);
    }();
    if (!key) return key.error();
    before = newest->after;
    half_spacing = half_spacing_of(frame.payload);
    after = std::make_shared<const ChainState>(
        ChainState{state.newer, std::move(*key), head.capture_us - newest->capture_us, phase});
  }
  return std::make_shared<const KeyRecord>(KeyRecord{.sequence = head.sequence,
                                                     .capture_us = head.capture_us,
                                                     .arrival_us = now_us,
                                                     .bands = head.bands,
                                                     .join = join,
                                                     .half_spacing = half_spacing,
                                                     .generation = after->phase ? memory->needed_at(*after->phase) : 0,
                                                     .before = before,
                                                     .after = after,
                                                     .payload{frame.payload.begin(), frame.payload.end()}});
}

Result<void> Stream::watch(Watcher& watcher, const Profile& wanted) {
  if (const auto checked = check_profile(wanted); !checked) return checked;
  deliver();
  const auto before = watched_.find(&watcher);
  const bool known = before != watched_.end();
  const std::uint32_t generation = known ? before->second.generation : 0;
  const std::uint32_t came_to = known ? before->second.came_to : present_.memory ? present_.memory->number : 0;
  const bool prepared = known && before->second.prepared;
  auto tracing = known ? std::move(before->second.tracing) : nullptr;
  auto place = known ? forget(watcher) : share_->take_place(watcher.holder(), settings_.max_watchers);
  if (!place) return place.error();
  if (!known) order_.push_back(&watcher);
  Watched& watched = watched_[&watcher] = {canonical(wanted), nullptr, std::move(*place), generation, came_to};
  watched.tracing = std::move(tracing);
  if (prepared && present_.next) note_prepared(watcher, present_.next->asset);
  if (present_.epoch != 0) join_group(watcher, watched);
  if (!awaits_snapshot_) watcher.on_stream_changed(*this, true);
  if (!known) report_count();
  return {};
}

bool Stream::improve(Watcher& watcher) {
  const auto found = watched_.find(&watcher);
  if (found == watched_.end() || found->second.group == nullptr) return false;
  const Profile present = found->second.group->feed.profile(), wanted = found->second.wanted;
  if (present == effective(wanted) || present == affordable(found->second, watcher)) return false;
  return static_cast<bool>(watch(watcher, wanted));
}

void Stream::unwatch(Watcher& watcher) {
  if (!watched_.contains(&watcher)) return;
  deliver();
  forget(watcher);
  std::erase(order_, &watcher);
  trace(watcher, 0);
  report_count();
}

void Stream::pump(TimeUs now_us) {
  for (auto& [key, group] : groups_) {
    if (group->retry_us && *group->retry_us <= now_us) group->add_key(*this, now_us);
    group->feed.pump(now_us, group->pending);
  }
  has_pending_ = true;
  deliver();
}

void Stream::deliver() {
  if (!std::exchange(has_pending_, false)) return;
  for (auto& [key, group] : groups_) deliver(*group);
}

double Stream::delivery_us() const {
  double us = 1;
  if (!has_pending_ && !due_us_) return us;
  for (const auto& [key, group] : groups_) {
    const std::size_t made = due_us_ ? 1 : 0;
    us += kOfferedUs * static_cast<double>((group->pending.size() + made) * group->watchers.size());
    if (due_us_ && group->feed.profile().scheme == Profile::Scheme::kCatmullRom) us += encoding_us(layout_, 0);
  }
  return us;
}

std::optional<TimeUs> Stream::next_due_us() const {
  std::optional<TimeUs> next;
  for (const auto& [key, group] : groups_) {
    for (const auto due : {group->feed.next_due_us(), group->retry_us}) {
      if (due && (!next || *due < *next)) next = due;
    }
  }
  return next;
}

void Stream::relay_trace(const control::Trace& trace) {
  for (StreamTap* tap : settings_.taps) tap->on_trace(*this, trace);
  const auto wanting = tracer_.who_wants(trace.sequence);
  const std::size_t elsewhere = mirror_trace_ != 0 ? watchers() - watchers_here() : 0;
  unpaid_us_ += kTraceUs * static_cast<double>(elsewhere + wanting.size());
  if (wanting.empty()) return;
  control::Trace relayed = trace;
  relayed.stream_id = id();
  relayed.epoch = present_.epoch;
  const std::string json = text_from_control(relayed);
  if (json.size() > limits::kMaxControlBytes) return;  // Numbers of this broker made it longer than viewers take.
  const auto text = websocket::framed(websocket::Opcode::kText, json);
  for (Watcher* watcher : wanting) watcher->on_trace(text);
}

bool Stream::trace(Watcher& watcher, std::uint32_t every) {
  const auto found = watched_.find(&watcher);
  if (every != 0 && found == watched_.end()) return true;
  if (every != 0 && !found->second.tracing) {
    if (!traced_.fits(watcher.holder(), 1, kMaxTraced)) return false;
    found->second.tracing = traced_.hold(watcher.holder(), 1);
  }
  if (every == 0 && found != watched_.end()) found->second.tracing.reset();
  const std::uint32_t before = tracer_.every();
  tracer_.want(watcher, every);
  if (tracer_.every() != before && publisher_ != nullptr) publisher_->on_trace_wanted();
  return true;
}

void Stream::set_mirror_trace(std::uint32_t every) {
  mirror_trace_ = every;
  if (publisher_ != nullptr) publisher_->on_trace_wanted();
}

void Stream::send_traces(Group& group) {
  for (const FramePtr& frame : group.traced) {
    auto wanting = tracer_.who_wants(frame->envelope.sequence);
    std::erase_if(wanting, [&](Watcher* who) { return watched_.at(who).group != &group; });
    const auto trace = wanting.empty() ? std::nullopt : tracer_.trace_of(*frame);
    if (!trace) continue;
    const auto text = websocket::framed(websocket::Opcode::kText, text_from_control(*trace));
    for (Watcher* watcher : wanting) watcher->on_trace(text);
  }
  group.traced.clear();
}

FramePtr Stream::join_for(const Watcher& watcher, double* work_us) {
  const auto found = watched_.find(&watcher);
  if (found == watched_.end() || found->second.group == nullptr) return nullptr;
  Feed& feed = found->second.group->feed;
  const bool encodes = !feed.has_join();
  FramePtr join = feed.join();
  if (encodes && join && work_us != nullptr) *work_us += encoding_us(layout_, join->wire.size());
  return join;
}

double Stream::decoding_us(std::uint64_t bytes, bool last) const {
  const bool exact = layout_.is_float();
  return (last ? static_cast<double>(layout_.size()) / (exact ? kFloatsPerUs : kDecodedPerUs) : 0) +
         static_cast<double>(bytes) / (exact ? kFloatBytesPerUs : kDecodedBytesPerUs);
}

control::StreamInfo Stream::info_for(const Watcher& watcher) const {
  control::StreamInfo info;
  info.stream = name_;
  info.state = state();
  info.stream_id = id();
  info.epoch = present_.epoch;
  info.tag = present_.tag;
  info.asset = present_.announced.asset;
  info.format = present_.announced.format;
  info.key_rate_hz = present_.announced.key_rate_hz;
  info.world = present_.announced.world;
  info.utc_us = present_.announced.utc_us;
  if (present_.next) info.next = *present_.next;
  info.profile = profile_of(watcher);
  info.rewind = rewind_;
  return info;
}

std::shared_ptr<const std::string> Stream::info_text(const Watcher& watcher) const {
  constexpr std::size_t kMaxTexts = 64;
  if (info_texts_.size() > kMaxTexts) info_texts_.clear();
  auto& text = info_texts_[profile_of(watcher)];
  if (!text) text = websocket::framed(websocket::Opcode::kText, text_from_control(info_for(watcher)));
  return text;
}

std::shared_ptr<const std::string> Stream::memory_text(std::size_t kept) const {
  constexpr std::size_t kMaxTexts = 8;
  if (memory_texts_.size() > kMaxTexts) memory_texts_.clear();
  auto& text = memory_texts_[kept];
  if (text) return text;
  const Generation& memory = *present_.memory;
  control::Remember message{name_, memory.number, static_cast<std::uint32_t>(kept), {}};
  for (std::size_t i = kept; i < memory.segments.size(); ++i) message.segments.push_back(memory.segments[i].id);
  text = websocket::framed(websocket::Opcode::kText, text_from_control(std::move(message)));
  return text;
}

Profile Stream::profile_of(const Watcher& watcher) const {
  const auto found = watched_.find(&watcher);
  if (found == watched_.end()) return {};
  return found->second.group != nullptr ? found->second.group->feed.profile() : found->second.wanted;
}

Profile Stream::effective(const Profile& wanted) const {
  Profile profile = wanted;
  profile.bands = std::clamp<std::uint8_t>(profile.bands, 1, bands());
  if (profile.scheme == Profile::Scheme::kHermite && present_.announced.format.velocity_channels == 0)
    profile.scheme = Profile::Scheme::kLinear;
  return profile;
}

/// What a new watcher of the profile gets. The `stream` message reports it.
Profile Stream::affordable(const Watched& watched, const Watcher& watcher) const {
  const Profile profile = effective(watched.wanted);
  const bool plain = needs_plain(watched);
  if (groups_.contains({profile, plain})) return profile;
  std::size_t cost = 0;
  std::vector<Profile> served;
  for (const auto& [key, group] : groups_) {
    const Profile& other = key.first;
    if (group->plain == plain) served.push_back(other);
    if (!is_common(other)) cost += cost_of(other);
  }
  const bool in_budget = is_common(profile) || cost + cost_of(profile) <= settings_.max_profiles;
  const Profile next = in_budget ? profile : nearest_profile(profile, served, true);
  const bool fits = groups_.contains({next, plain}) ||
                    settings_.memory->encoded.fits(watcher.holder(), encoded_bytes(layout_, next), settings_.max_bytes);
  return fits ? next : nearest_profile(profile, served, false);
}

void Stream::join_group(Watcher& watcher, Watched& watched, const Feed* former) {
  const Profile profile = affordable(watched, watcher);
  const bool plain = needs_plain(watched);
  auto& group = groups_[{profile, plain}];
  if (!group) {
    const VelocityChannels velocities{present_.announced.format.velocity_channels,
                                      present_.announced.format.velocity_us};
    group = std::make_unique<Group>(profile, plain,
                                    Feed::Source{layout_, velocities, id(), present_.epoch, present_.tag,
                                                 settings_.max_span_us, settings_.max_ahead_us});
    group->memory = settings_.memory->encoded.hold(watcher.holder(), encoded_bytes(layout_, profile));
    if (former != nullptr) group->feed.keep_pace_of(*former);
    double work_us = 0;
    if (present_.newest) group->feed.begin_at(plain ? this->plain(&work_us) : present_.newest);
    watcher.charge_key(work_us);
  }
  group->watchers.push_back(&watcher);
  watched.group = group.get();
}

/// Gives up its profile and its slot in the group. Returns its place.
std::shared_ptr<void> Stream::forget(const Watcher& watcher) {
  const auto found = watched_.find(&watcher);
  leave_group(watcher, found->second);
  if (found->second.prepared && present_.next) share_->note_prepared(present_.next->asset, watcher.holder(), -1);
  auto place = std::move(found->second.place);
  watched_.erase(found);
  return place;
}

void Stream::leave_group(const Watcher& watcher, Watched& watched) {
  Group* group = std::exchange(watched.group, nullptr);
  if (group == nullptr) return;
  group->remove(watcher);
  if (group->watchers.empty()) groups_.erase(GroupKey(group->feed.profile(), group->plain));
}

/// Who pays stays the same.
void Stream::Group::remove(const Watcher& watcher) {
  const auto found = std::find(watchers.begin(), watchers.end(), &watcher);
  if (static_cast<std::size_t>(found - watchers.begin()) < payer) --payer;
  watchers.erase(found);
}

template <typename Pays>
bool Stream::Group::find_payer(Pays pays) {
  std::vector<const void*> empty;
  for (std::size_t left = watchers.size(); left > 0; --left, ++payer) {
    Watcher& watcher = *watchers[payer %= watchers.size()];
    if (std::find(empty.begin(), empty.end(), watcher.purse()) != empty.end()) continue;
    if (empty.size() == kMaxPayersAsked) return false;
    if (pays(watcher)) return true;
    empty.push_back(watcher.purse());
  }
  return false;
}

bool Stream::Group::charge_poses(double work_us) {
  if (work_us > 0) return watchers[payer % watchers.size()]->charge_poses(work_us);
  return find_payer([](Watcher& watcher) { return watcher.charge_poses(0); });
}

void Stream::Group::add_key(const Stream& stream, TimeUs now_us) {
  const KeyRecordPtr& record = stream.present_.newest;
  const double work_us = kProfileKeyUs + static_cast<double>(record->payload.size()) / kProfileKeyBytesPerUs;
  retry_us.reset();
  if ((feed.profile().rate == Profile::Rate::kRaw && !plain) ||
      find_payer([&](Watcher& watcher) { return watcher.take_key(work_us); })) {
    // A few bytes of a key may name any of its sender's poses, so that the plain one is long.
    double coding_us = 0;
    feed.add_key(plain ? stream.plain(&coding_us) : record, now_us, pending);
    // Its sender pays, too: viewers at many addresses have many budgets.
    stream.unpaid_us_ += coding_us;
    return watchers[payer % watchers.size()]->charge_key(coding_us);
  }
  feed.leave_gap();
  retry_us = now_us + kRetryUs;
}

void Stream::deliver(Group& group) {
  const std::vector<FramePtr>& frames = group.pending;
  frames_made_ += frames.size();
  poses_failed_ += group.feed.take_failed_poses();
  if (frames.empty()) return;
  for (Watcher* watcher : group.watchers) watcher->on_frames(*this, frames);
  if (tracer_.every() != 0) {
    // Traces of earlier frames: the present ones may be written only at the end of the turn.
    send_traces(group);
    for (const FramePtr& frame : frames) {
      if (tracer_.is_traced(frame->envelope.sequence)) group.traced.push_back(frame);
    }
  }
  group.pending.clear();
}

void Stream::report_count() {
  for (StreamTap* tap : settings_.taps) tap->on_demand_changed(*this);
  if (publisher_ != nullptr) publisher_->on_watcher_count(watchers());
}

}  // namespace eigencast::broker
