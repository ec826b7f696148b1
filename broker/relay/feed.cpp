// SPDX-License-Identifier: MIT
#include "broker/relay/feed.h"

#include <algorithm>
#include <cassert>

#include "common/motion/curve.h"

namespace eigencast::broker {
namespace {

// The pacer never holds more than three key intervals, so a key that waits longer has been overtaken.
constexpr std::size_t kMaxPendingKeys = 5;

// Two intervals at the usual x3; few enough that other streams do not wait.
constexpr std::size_t kMaxPrepared = 4;

// Synthetic poses are shown for a fraction of a key interval and nothing builds on them, so they are quantised more
// coarsely than keys: the added error is far below that of interpolation (docs/performance.md).
constexpr unsigned kSyntheticSpacingNumerator = 5, kSyntheticSpacingDenominator = 2;
constexpr unsigned kMaxHalfSpacing = 63;

// What the codec takes on one core of 2026, rounded up (bench/codec_rate.cpp): 28 us for a key of 180 bytes, 190 us for
// a join of 32,768 coefficients that change by nothing.
constexpr double kEncodedPerUs = 170, kEncodedBytesPerUs = 5;

bool is_compact(const Profile& profile) {
  return profile.rate == Profile::Rate::kInterpolated && profile.form == Profile::Form::kCompact;
}

/// Whether its poses depend only on the two neighbouring keys and are sent in full.
bool can_prepare_poses(const Profile& profile) {
  return profile.rate == Profile::Rate::kInterpolated && !is_compact(profile) &&
         profile.scheme != Profile::Scheme::kCatmullRom;
}

/// Orders poses between keys.
std::pair<std::uint64_t, std::uint8_t> order_of(const Pacer::Due& due) {
  return {due.sequence, due.at};
}
std::pair<std::uint64_t, std::uint8_t> order_of(const Frame& frame) {
  return {frame.envelope.sequence, frame.envelope.step.at};
}

Bytes frame_without_id(const KeyRecord& record, bool join, BandMask bands, ByteView payload) {
  const ChainClock before = record.clock_before();
  Bytes out;
  out.reserve(Envelope::kMaxBytes + payload.size());
  append_envelope({.kind = join ? FrameKind::kJoin : FrameKind::kKey,
                   .bands = bands,
                   .step = {},
                   .sequence = record.sequence,
                   .capture_us = record.capture_us,
                   .age_us = join ? record.after->age_us : 0},
                  &before, out);
  ByteWriter(out).bytes(payload);
  return out;
}

constexpr std::int64_t kFormBytes = 2048;  ///< Of a stream or feed without coefficients.

/// Bytes of a value in a key, and of one that is coded, at most.
std::pair<std::int64_t, std::int64_t> value_bytes(CodecKind codec) {
  return {codec == CodecKind::kQuantised ? 4 : 8, codec == CodecKind::kFloat64 ? 8 : 4};
}

}  // namespace

std::size_t memory_of(const ChainState& state) {
  const auto values = [](const Key& key) { return sizeof(key.q[0]) * key.q.size() + sizeof(key.f[0]) * key.f.size(); };
  return values(state.older) + values(state.newer);
}

std::size_t memory_of(const KeyRecord& record) {
  return record.payload.size() + memory_of(*record.after);
}

std::int64_t keys_bytes(const StreamFormat& format) {
  const auto known = codec_from_name(format.codec);
  const auto [held, coded] = value_bytes(known ? *known : CodecKind::kFloat64);
  // The key emitted last and the one before are held as well.
  const std::int64_t records = kMaxPendingKeys + 2;
  return kFormBytes + std::int64_t{format.rows} * format.channels * (2 * held + coded) * records;
}

std::int64_t encoded_bytes(const CoefficientLayout& layout, const Profile& profile) {
  // A join is two keys; a key and a pose wait for viewers.
  std::int64_t poses = 3;
  if (profile.rate != Profile::Rate::kRaw && profile.form == Profile::Form::kFull) ++poses;
  if (can_prepare_poses(profile)) poses += kMaxPrepared;
  const auto values = static_cast<std::int64_t>(layout.range(profile.bands - 1u).second);
  return kFormBytes + values * value_bytes(layout.codec).second * poses;
}

double encoding_us(const CoefficientLayout& layout, std::size_t bytes) {
  const double bytes_us = layout.is_float() ? 0 : static_cast<double>(bytes) / kEncodedBytesPerUs;
  return static_cast<double>(layout.size()) / kEncodedPerUs + bytes_us;
}

ChainClock KeyRecord::clock_before() const {
  return {sequence - 1, capture_us - after->age_us, before ? before->age_us : 0};
}

Bytes KeyRecord::frame() const {
  return frame_without_id(*this, join, bands, payload);
}

Result<Bytes> KeyRecord::join_frame(const CoefficientLayout& layout) const {
  const auto state = encode_join(layout, *after);
  if (!state) return state.error();
  return frame_without_id(*this, true, after->newer.bands, *state);
}

Feed::Feed(const Profile& profile, const Source& source, Payer payer)
    : profile_(profile),
      source_(source),
      payer_(std::move(payer)),
      mask_(BandMask::lowest(profile.bands) & source.layout.all_bands()),
      pacer_(profile.k, source.max_span_us, profile.scheme == Profile::Scheme::kCatmullRom ? 1 : 0),
      forecaster_(profile.k, source.max_ahead_us, source.max_span_us) {}

void Feed::begin_at(KeyRecordPtr record) {
  assert(!last_emitted_ && pending_.empty());
  pacer_.add_key(record->sequence, record->capture_us, record->arrival_us);
  forecaster_.add_key(record->sequence, record->capture_us, record->arrival_us);
  set_last_emitted(std::move(record));
}

void Feed::add_key(KeyRecordPtr record, TimeUs now_us, std::vector<FramePtr>& out) {
  if (profile_.rate == Profile::Rate::kRaw) return emit_key(std::move(record), 0, out);
  const bool gap = std::exchange(gap_, false) || !record->before;
  if (profile_.rate == Profile::Rate::kEstimated) {
    if (gap) forecaster_.reset();
    forecaster_.add_key(record->sequence, record->capture_us, now_us);
    emit_key(std::move(record), 0, out);
    return pump_estimates(now_us, out);
  }
  if (gap) {  // Pending poses build on the old chain.
    pacer_.reset();
    pending_.clear();
    prepared_.clear();
    steps_pending_ = false;
  }
  pacer_.add_key(record->sequence, record->capture_us, now_us);
  if (is_compact(profile_) && gap) return emit_key(std::move(record), 0, out);
  pending_.push_back(std::move(record));
  if (is_compact(profile_) && !steps_pending_) emit_pending_ahead(out);
  while (pending_.size() > kMaxPendingKeys) {
    emit_key(pending_.front(), is_compact(profile_) ? Envelope::kAhead : std::uint8_t{0}, out);
    pending_.pop_front();
  }
  pump(now_us, out);
}

void Feed::pump(TimeUs now_us, std::vector<FramePtr>& out) {
  if (profile_.rate == Profile::Rate::kRaw) return;
  if (profile_.rate == Profile::Rate::kEstimated) return pump_estimates(now_us, out);
  while (const auto due = pacer_.pop_due(now_us)) {
    const auto next_us = pacer_.next_due_us();
    const bool overtaken = next_us && *next_us <= now_us;
    behind_ = overtaken || (behind_ && due->at < due->of);
    const std::size_t made = out.size();
    if (is_compact(profile_)) {
      pump_compact(*due, overtaken, out);
    } else {
      pump_full(*due, overtaken, out);
    }
    for (std::size_t i = made; i < out.size(); ++i) out[i]->times.due_us = due->due_us;
  }
}

std::optional<TimeUs> Feed::next_due_us() const {
  if (profile_.rate == Profile::Rate::kRaw) return std::nullopt;
  return profile_.rate == Profile::Rate::kEstimated ? forecaster_.next_due_us() : pacer_.next_due_us();
}

void Feed::pump_estimates(TimeUs now_us, std::vector<FramePtr>& out) {
  while (const auto due = forecaster_.pop_due(now_us)) {
    const auto next_us = forecaster_.next_due_us();
    if (!next_us || *next_us > now_us) emit_estimate(*due, out);
  }
}

void Feed::pump_full(const Pacer::Due& due, bool overtaken, std::vector<FramePtr>& out) {
  // Keys whose turn was skipped are still emitted, in order: receivers need the whole chain.
  while (!pending_.empty() && pending_.front()->sequence < due.sequence) {
    emit_key(pending_.front(), 0, out);
    pending_.pop_front();
  }
  if (pending_.empty() || pending_.front()->sequence != due.sequence) return;
  if (due.at < due.of) {
    if (!overtaken) emit_synthetic(*pending_.front(), due, out);
    return;
  }
  emit_key(pending_.front(), 0, out);
  pending_.pop_front();
}

void Feed::pump_compact(const Pacer::Due& due, bool overtaken, std::vector<FramePtr>& out) {
  while (!pending_.empty() && pending_.front()->sequence <= due.sequence) emit_pending_ahead(out);
  if (!last_emitted_ || last_emitted_->sequence != due.sequence || !steps_pending_) return;
  if (!overtaken) {
    out.push_back(make_frame(envelope(FrameKind::kStep, *last_emitted_, &due), nullptr, {}));
  }
  if (due.at < due.of) return;
  steps_pending_ = false;
  join_.reset();  // The next one is shown on arrival.
  if (!pending_.empty()) emit_pending_ahead(out);
}

void Feed::emit_pending_ahead(std::vector<FramePtr>& out) {
  KeyRecordPtr record = std::move(pending_.front());
  pending_.pop_front();
  emit_key(std::move(record), Envelope::kAhead, out);
  steps_pending_ = true;
}

void Feed::emit_key(KeyRecordPtr record, std::uint8_t flags, std::vector<FramePtr>& out) {
  Envelope head = envelope(record->join ? FrameKind::kJoin : FrameKind::kKey, *record);
  head.bands = record->bands & mask_;
  head.flags = flags;
  const ChainClock newest = record->clock_before();
  if (head.bands == record->bands) {
    out.push_back(make_frame(head, &newest, record->payload));
    out.back()->times.arrival_us = record->arrival_us;
  } else if (const auto cut = cut_bands(source_.layout, record->join, record->bands, mask_, record->payload)) {
    out.push_back(make_frame(head, &newest, *cut));
  } else {
    ++failed_poses_;  // Receivers miss this key and get a join next.
  }
  set_last_emitted(std::move(record));
}

void Feed::emit_synthetic(const KeyRecord& record, const Pacer::Due& due, std::vector<FramePtr>& out) {
  if (!record.before || !last_emitted_ || last_emitted_->sequence + 1 != record.sequence) return;
  FramePtr frame = take_prepared(due);
  emit_made(frame ? std::move(frame) : synthetic(record, due), out);
}

void Feed::emit_estimate(const Pacer::Due& due, std::vector<FramePtr>& out) {
  if (!last_emitted_ || last_emitted_->sequence != due.sequence || !last_emitted_->before) return;
  const Envelope head = envelope(FrameKind::kEstimate, *last_emitted_, &due);
  if (profile_.form == Profile::Form::kCompact) return out.push_back(make_frame(head, nullptr, {}));
  const ChainState& state = *last_emitted_->after;
  const bool damped = profile_.scheme == Profile::Scheme::kDamped;
  if (!payer_(0)) return emit_made(nullptr, out);
  const auto pose = estimate_keys(source_.layout, state.older, state.newer, damped, due.at, due.of);
  emit_made(made(head, nullptr, last_emitted_->half_spacing, state, pose), out);
}

void Feed::emit_made(FramePtr frame, std::vector<FramePtr>& out) {
  if (!frame) return void(++failed_poses_);
  out.push_back(std::move(frame));
}

FramePtr Feed::synthetic(const KeyRecord& record, const Pacer::Due& due) {
  if (!payer_(0)) return nullptr;
  const ChainClock newest = record.clock_before();
  return made(envelope(FrameKind::kSynthetic, record, &due), &newest, record.half_spacing, *record.before,
              pose_between(record, due));
}

FramePtr Feed::made(Envelope head, const ChainClock* newest, std::uint8_t key_spacing, const ChainState& state,
                    Result<Key> pose) const {
  std::optional<Bytes> payload;
  if (pose) {
    const unsigned half_spacing =
        std::min(kMaxHalfSpacing, unsigned{key_spacing} * kSyntheticSpacingNumerator / kSyntheticSpacingDenominator);
    pose->bands &= mask_;  // Bands are encoded independently.
    head.bands = pose->bands;
    if (auto coded = encode_pose(source_.layout, state, *std::move(pose), static_cast<std::uint8_t>(half_spacing)))
      payload = *std::move(coded);
  }
  payer_(encoding_us(source_.layout, payload ? payload->size() : 0));
  return payload ? make_frame(head, newest, *payload) : nullptr;
}

void Feed::prepare() {
  if (behind_ || !can_prepare_poses(profile_)) return;
  auto record = pending_.begin();
  for (const Pacer::Due& due : pacer_.waiting()) {
    if (prepared_.size() == kMaxPrepared) return;
    while (record != pending_.end() && (*record)->sequence < due.sequence) ++record;
    if (record == pending_.end()) return;
    if (due.at == due.of || (*record)->sequence != due.sequence || !(*record)->before) continue;
    if (!prepared_.empty() && order_of(due) <= order_of(*prepared_.back())) continue;
    FramePtr frame = synthetic(**record, due);
    if (!frame) return;  // Counted when the pose is due.
    prepared_.push_back(std::move(frame));
  }
}

FramePtr Feed::take_prepared(const Pacer::Due& due) {
  while (!prepared_.empty() && order_of(*prepared_.front()) < order_of(due))
    prepared_.pop_front();  // They were overtaken.
  if (prepared_.empty() || order_of(*prepared_.front()) != order_of(due)) return nullptr;
  FramePtr frame = std::move(prepared_.front());
  prepared_.pop_front();
  return frame;
}

Result<Key> Feed::pose_between(const KeyRecord& record, const Pacer::Due& due) {
  const Key &from = record.before->newer, &to = record.after->newer;
  // A pose held by the sender (docs/protocol.md, section 5) rests between its keys: a curve with the slope of the
  // earlier movement would leave it.
  if (profile_.scheme == Profile::Scheme::kCatmullRom && from == to) return to;
  switch (profile_.scheme) {
    case Profile::Scheme::kHermite:
      return hermite_keys(source_.layout, source_.velocities, from, to, record.after->age_us, due.at, due.of);
    case Profile::Scheme::kCatmullRom: {
      const KeyRecord* next = pending_.size() > 1 ? pending_[1].get() : nullptr;
      if (next != nullptr && (!next->before || next->capture_us - record.capture_us > source_.max_span_us))
        next = nullptr;
      // Decided once per interval: a curve that changes its shape midway would jump.
      if (!curve_ || curve_->sequence != record.sequence) curve_ = Curve{record.sequence, next != nullptr};
      return pose_on_curve(record, curve_->with_next ? next : nullptr, due.capture_us);
    }
    case Profile::Scheme::kLinear:
    case Profile::Scheme::kDamped:
      break;
  }
  return interpolate_keys(source_.layout, from, to, due.at, due.of);
}

Result<Key> Feed::pose_on_curve(const KeyRecord& record, const KeyRecord* next, TimeUs t_us) const {
  const ChainState &before = *record.before, &after = *record.after;
  const TimeUs from_us = record.capture_us - after.age_us;
  const bool has_before = before.age_us > 0 && before.age_us <= source_.max_span_us;
  const CurveWeights w =
      catmull_rom_weights(has_before ? std::optional(from_us - before.age_us) : std::nullopt, from_us,
                          record.capture_us, next != nullptr ? std::optional(next->capture_us) : std::nullopt, t_us);
  std::vector<const Key*> keys{&before.newer, &after.newer};
  std::vector<double> weights{w.from, w.to};
  const auto add = [&](const Key& key, double weight) {
    keys.push_back(&key);
    weights.push_back(weight);
  };
  if (has_before) add(before.older, w.before);
  if (next != nullptr) add(next->after->newer, w.after);
  return blend_keys(source_.layout, keys, weights, 1);
}

FramePtr Feed::join() {
  if (join_ || !last_emitted_) return join_;
  const ChainState& state = *last_emitted_->after;
  const BandMask bands = state.newer.bands;
  auto payload = encode_join(source_.layout, state);
  if (payload && !mask_.includes(bands)) payload = cut_bands(source_.layout, true, bands, mask_, *payload);
  if (!payload) {
    ++failed_poses_;
    return nullptr;
  }
  Envelope head = envelope(FrameKind::kJoin, *last_emitted_);
  head.bands = bands & mask_;
  head.flags = steps_pending_ ? Envelope::kAhead : std::uint8_t{0};
  join_ = make_frame(head, nullptr, *payload);
  return join_;
}

Envelope Feed::envelope(FrameKind kind, const KeyRecord& record, const Pacer::Due* due) const {
  return {.kind = kind,
          .bands = {},
          .step = due != nullptr ? InterpolationStep{due->at, due->of} : InterpolationStep{},
          .stream_id = source_.stream_id,
          .epoch = source_.epoch,
          .sequence = record.sequence,
          .capture_us = due != nullptr ? due->capture_us : record.capture_us,
          .tag = source_.tag,
          .age_us = kind == FrameKind::kJoin ? record.after->age_us : 0};
}

void Feed::set_last_emitted(KeyRecordPtr record) {
  last_emitted_ = std::move(record);
  join_.reset();
}

}  // namespace eigencast::broker
