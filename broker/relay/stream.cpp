// SPDX-License-Identifier: MIT
#include "broker/relay/stream.h"

#include <algorithm>
#include <cassert>
#include <utility>

#include "broker/relay/profile_budget.h"
#include "broker/websocket/protocol.h"
#include "common/wire/limits.h"

namespace eigencast::broker {
namespace {

// What the codec takes on one core of 2026, rounded up: 16 us for a key of 180 bytes (bench/codec_rate.cpp); for one of
// few bytes that changes most of 32,768 coefficients 275 us, from a memory 400, to code it anew 590.
constexpr double kDecodedPerUs = 120, kDecodedBytesPerUs = 8, kFloatsPerUs = 450, kFloatBytesPerUs = 2000;
constexpr double kRecalledPerUs = 250, kCodedAnewPerUs = 85;  ///< Besides decoding; besides encoding_us().

constexpr double kOfferedUs = 0.25;      ///< A frame and a viewer, with what brings it to the socket.
constexpr double kTraceUs = 2;           ///< A viewer that is told one.
constexpr std::int64_t kMaxTraced = 64;  ///< Viewers of a stream that are told any, as its sender pays.
constexpr double kBeginAnewUs = 10;      ///< A viewer: it is told, and its chain begins anew.
constexpr double kInfoUs = 40;           ///< A profile: the text of what its viewers are told.
constexpr double kChangeChainUs = 5;     ///< A viewer that gains or lacks what keys need.

}  // namespace

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
    unpaid_us_ += telling_us();
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
  unpaid_us_ += kOfferUs * watchers();
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
  return found->second.group->feed.join(work_us);
}

double Stream::telling_us() const {
  return kBeginAnewUs * watchers() + kInfoUs * static_cast<double>(groups_.size());
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
  // Those of all profiles that are served, so that each is made once. Of a stream that waits it may be any.
  if (info_texts_.size() > settings_.max_profiles + kCommonProfiles) info_texts_.clear();
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

void Stream::deliver(Group& group) {
  const std::vector<FramePtr>& frames = group.pending;
  frames_made_ += frames.size();
  poses_failed_ += group.feed.take_failed_poses();
  if (frames.empty()) return;
  const std::span<const FramePtr> made = frames;
  for (Watcher* watcher : group.watchers) watcher->on_frames(*this, made);
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
