// SPDX-License-Identifier: MIT
#include "broker/relay/feed.h"

#include <algorithm>
#include <cassert>

#include "common/codec/recaller.h"
#include "common/motion/curve.h"

namespace eigencast::broker {
namespace {

// The pacer never holds more than three key intervals, so a key that waits longer has been overtaken.
constexpr std::size_t kMaxPendingKeys = 5;

// What the codec takes on one core of 2026, rounded up: 28 us for a key of 180 bytes; for a join of 32,768 coefficients
// that change by nothing 190 us, by much in few places (28 kB) 1,060, by something everywhere (110 kB) 790.
constexpr double kEncodedPerUs = 170, kEncodedBytesPerUs = 5;
constexpr double kLongUs = 30, kLongBytesPerUs = 32;  ///< Of long payloads.

Bytes frame_without_id(const KeyRecord& record, bool join, bool recalled, BandMask bands, ByteView payload, Bytes out) {
  const ChainClock before = record.clock_before();
  out.reserve(out.size() + Envelope::kMaxBytes + payload.size());
  append_envelope({.kind = join ? FrameKind::kJoin : FrameKind::kKey,
                   .flags = recalled ? Envelope::kRecalled : std::uint8_t{0},
                   .bands = bands,
                   .step = {},
                   .sequence = record.sequence,
                   .capture_us = record.capture_us,
                   .age_us = record.after->age_us},
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
  // A join is two keys; a key and maybe a residual wait for viewers.
  const std::int64_t poses = profile.scheme == Profile::Scheme::kCatmullRom ? 4 : 3;
  const auto values = static_cast<std::int64_t>(layout.range(profile.bands - 1u).second);
  return kFormBytes + values * value_bytes(layout.codec).second * poses;
}

double encoding_us(const CoefficientLayout& layout, std::size_t bytes) {
  const auto size = static_cast<double>(bytes);
  const double bytes_us = std::min(size / kEncodedBytesPerUs, kLongUs + size / kLongBytesPerUs);
  return static_cast<double>(layout.size()) / kEncodedPerUs + (layout.is_float() ? 0 : bytes_us);
}

ChainClock KeyRecord::clock_before() const {
  return {sequence - 1, capture_us - after->age_us, before ? before->age_us : 0};
}

Bytes KeyRecord::frame(Bytes head) const {
  return frame_without_id(*this, join, generation != 0, bands, payload, std::move(head));
}

Result<Bytes> KeyRecord::join_frame(const CoefficientLayout& layout, Bytes head) const {
  const auto state = encode_join(layout, *after);
  if (!state) return state.error();
  return frame_without_id(*this, true, after->phase.has_value(), after->newer.bands, *state, std::move(head));
}

KeyRecordPtr plain_record(const CoefficientLayout& layout, const KeyRecord& record, const KeyRecord* before) {
  KeyRecord plain{.sequence = record.sequence,
                  .capture_us = record.capture_us,
                  .arrival_us = record.arrival_us,
                  .bands = record.after->newer.bands,
                  .half_spacing = record.half_spacing,
                  .before = before != nullptr ? before->after : nullptr,
                  .after = {},
                  .payload = {}};
  // Finer than the sender's, so that the error of both is little more than the sender's.
  const std::uint8_t half_spacing = remembered_half_spacing(record.half_spacing);
  if (auto coded = before != nullptr ? encode_key(layout, *before->after, record.after->newer, half_spacing)
                                     : Result<CodedKey>(Error{})) {
    plain.payload = std::move(coded->payload);
    plain.after = std::make_shared<const ChainState>(
        ChainState{before->after->newer, std::move(coded->key), record.after->age_us});
  } else {
    ChainState state = *record.after;
    state.phase.reset();
    plain.before.reset();
    plain.join = true;
    if (auto join = encode_join(layout, state)) plain.payload = *std::move(join);  // It fits: it was decoded.
    plain.after = std::make_shared<const ChainState>(std::move(state));
  }
  return std::make_shared<const KeyRecord>(std::move(plain));
}

Feed::Feed(const Profile& profile, const Source& source, Payer payer)
    : profile_(profile),
      source_(source),
      payer_(std::move(payer)),
      mask_(BandMask::lowest(profile.bands) & source.layout.all_bands()),
      pacer_(profile.k, source.max_span_us, profile.scheme == Profile::Scheme::kCatmullRom ? 1 : 0),
      forecaster_(profile.k, source.max_ahead_us, source.max_span_us) {}

void Feed::keep_pace_of(const Feed& former) {
  if (former.profile_.k != profile_.k || former.profile_.scheme != profile_.scheme) return;
  pacer_ = former.pacer_;
  forecaster_ = former.forecaster_;
}

void Feed::begin_at(KeyRecordPtr record) {
  assert(!last_emitted_ && pending_.empty());
  pacer_.add_key(record->sequence, record->capture_us, record->arrival_us);
  forecaster_.add_key(record->sequence, record->capture_us, record->arrival_us);
  set_last_emitted(std::move(record));
}

void Feed::add_key(KeyRecordPtr record, TimeUs now_us, std::vector<FramePtr>& out) {
  if (profile_.rate == Profile::Rate::kRaw) return emit_key(std::move(record), std::nullopt, out);
  const bool gap = std::exchange(gap_, false) || !record->before;
  if (profile_.rate == Profile::Rate::kEstimated) {
    if (gap) forecaster_.reset();
    forecaster_.add_key(record->sequence, record->capture_us, now_us);
    emit_key(std::move(record), std::nullopt, out);
    return pump_estimates(now_us, out);
  }
  if (gap) {  // Pending poses build on the old chain.
    pacer_.reset();
    pending_.clear();
    steps_pending_ = false;
  }
  pacer_.add_key(record->sequence, record->capture_us, now_us);
  pending_.push_back(std::move(record));
  if (pending_.size() > kMaxPendingKeys) emit_key(take_pending(), std::nullopt, out);
  pump(now_us, out);
}

void Feed::pump(TimeUs now_us, std::vector<FramePtr>& out) {
  if (profile_.rate == Profile::Rate::kRaw) return;
  if (profile_.rate == Profile::Rate::kEstimated) return pump_estimates(now_us, out);
  while (const auto due = pacer_.pop_due(now_us)) {
    const auto next_us = pacer_.next_due_us();
    const std::size_t made = out.size();
    emit_due(*due, next_us && *next_us <= now_us, out);
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
    const bool overtaken = next_us && *next_us <= now_us;
    if (overtaken || !last_emitted_ || last_emitted_->sequence != due->sequence || !last_emitted_->before) continue;
    out.push_back(make_frame(envelope(FrameKind::kEstimate, *last_emitted_, &*due), nullptr, {}));
  }
}

void Feed::emit_due(const Pacer::Due& due, bool overtaken, std::vector<FramePtr>& out) {
  // Keys whose turn was skipped are still emitted, in order: receivers need the whole chain.
  while (!pending_.empty() && pending_.front()->sequence < due.sequence) emit_key(take_pending(), std::nullopt, out);
  const bool is_last = due.at == due.of;
  KeyRecordPtr record;
  if (!pending_.empty() && pending_.front()->sequence == due.sequence) {
    if (is_last) return emit_key(take_pending(), std::nullopt, out);
    if (!overtaken) record = take_pending();
  }
  const bool leads_up = steps_pending_ && last_emitted_->sequence == due.sequence;
  if (is_last && leads_up) steps_pending_ = false;
  if (overtaken || !(record || leads_up)) return;
  const auto rest = residual(record ? *record : *last_emitted_, due);
  const bool alone = rest && rest->bands.empty();  // A step says it all, and so may the key.
  shown_ = alone ? InterpolationStep{due.at, due.of} : InterpolationStep{};
  if (record)
    emit_key(std::move(record), shown_, out);
  else if (alone)
    out.push_back(make_frame(envelope(FrameKind::kStep, *last_emitted_, &due), nullptr, {}));
  if (!rest || alone) return;
  Envelope head = envelope(FrameKind::kStep, *last_emitted_, &due);
  head.bands = rest->bands;
  out.push_back(make_frame(head, nullptr, rest->payload));
}

KeyRecordPtr Feed::take_pending() {
  KeyRecordPtr record = std::move(pending_.front());
  pending_.pop_front();
  return record;
}

void Feed::emit_key(KeyRecordPtr record, std::optional<InterpolationStep> ahead, std::vector<FramePtr>& out) {
  Envelope head = envelope(record->join ? FrameKind::kJoin : FrameKind::kKey, *record);
  head.bands = record->bands & mask_;
  const bool recalled = record->generation != 0;
  head.flags = static_cast<std::uint8_t>((ahead ? Envelope::kAhead : 0) | (recalled ? Envelope::kRecalled : 0));
  head.step = ahead.value_or(InterpolationStep{});
  steps_pending_ = ahead.has_value();
  const ChainClock newest = record->clock_before();
  if (head.bands == record->bands) {
    out.push_back(make_frame(head, &newest, record->payload));
    out.back()->times.arrival_us = record->arrival_us;
  } else if (const auto cut =
                 cut_bands(source_.layout, record->join, record->bands, mask_, record->payload, recalled)) {
    out.push_back(make_frame(head, &newest, *cut));
  } else {
    ++failed_poses_;  // Receivers miss this key and get a join next.
  }
  set_last_emitted(std::move(record));
}

std::optional<CodedResidual> Feed::residual(const KeyRecord& record, const Pacer::Due& due) {
  const Key &from = record.before->newer, &to = record.after->newer;
  // A pose held by the sender (docs/protocol.md, section 5) rests between its keys: a curve with the slope of the
  // earlier movement would leave it.
  if (profile_.scheme != Profile::Scheme::kCatmullRom || due.at == due.of || from == to) return CodedResidual{};
  const KeyRecord* next = pending_.empty() ? nullptr : pending_.front().get();
  if (next != nullptr && (!next->before || next->capture_us - record.capture_us > source_.max_span_us)) next = nullptr;
  // Decided once per interval: a curve that changes its shape midway would jump.
  if (!curve_ || curve_->sequence != record.sequence) curve_ = Curve{record.sequence, next != nullptr};
  if (!payer_(0)) {
    ++failed_poses_;
    return std::nullopt;
  }
  auto coded = [&]() -> Result<CodedResidual> {
    auto base = interpolate_keys(source_.layout, from, to, due.at, due.of);
    if (!base) return base.error();
    auto pose = pose_on_curve(record, curve_->with_next ? next : nullptr, due.capture_us);
    if (!pose) return pose.error();
    base->bands &= mask_;
    return encode_residual(source_.layout, *base, *std::move(pose), record.half_spacing);
  }();
  payer_(encoding_us(source_.layout, coded ? coded->payload.size() : 0));
  if (coded) return *std::move(coded);
  ++failed_poses_;
  return std::nullopt;
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

FramePtr Feed::join(double* work_us) {
  if (!last_emitted_) return nullptr;
  const ChainState& state = *last_emitted_->after;
  Envelope head = envelope(FrameKind::kJoin, *last_emitted_);
  head.flags =
      static_cast<std::uint8_t>((steps_pending_ ? Envelope::kAhead : 0) | (state.phase ? Envelope::kRecalled : 0));
  head.step = steps_pending_ ? shown_ : InterpolationStep{};
  if (join_ && join_->envelope.flags == head.flags && join_->envelope.step == head.step) return join_;
  const BandMask bands = state.newer.bands;
  if (join_payload_.empty()) {
    auto payload = encode_join(source_.layout, state);
    // All bands are coded, however few of them stay.
    if (work_us != nullptr) *work_us += encoding_us(source_.layout, payload ? payload->size() : 0);
    if (payload && !mask_.includes(bands))
      payload = cut_bands(source_.layout, true, bands, mask_, *payload, state.phase.has_value());
    if (!payload) {
      ++failed_poses_;
      return nullptr;
    }
    join_payload_ = *std::move(payload);
  }
  head.bands = bands & mask_;
  join_ = make_frame(head, nullptr, join_payload_);
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
          .age_us = due == nullptr ? record.after->age_us : 0};
}

void Feed::set_last_emitted(KeyRecordPtr record) {
  last_emitted_ = std::move(record);
  join_.reset();
  join_payload_.clear();
}

}  // namespace eigencast::broker
