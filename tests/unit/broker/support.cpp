// SPDX-License-Identifier: MIT
#include "tests/unit/broker/support.h"

#include "common/asset/format/manifest.h"

namespace eigencast::broker::testing {

CoefficientLayout small_layout() {
  return {CodecKind::kQuantised, 8, 3, {4, 8}};
}

control::Announce small_announce() {
  control::Announce announce;
  announce.asset = std::string(64, 'a');
  announce.format = {8, 3, {4, 8}, "quantised"};
  announce.key_rate_hz = 30;
  return announce;
}

control::Announce large_announce() {
  control::Announce announce = small_announce();
  announce.format = {4096, 8, {4096}, "quantised"};
  return announce;
}

Bytes large_message(const Stream& stream, std::uint64_t sequence, TimeUs capture_us) {
  const KeyRecordPtr& newest = stream.snapshot().newest;
  const ChainClock clock = newest ? newest->clock() : ChainClock{};
  Bytes message;
  append_envelope({.kind = sequence == 0 ? FrameKind::kJoin : FrameKind::kKey,
                   .bands = 1,
                   .step = {},
                   .sequence = sequence,
                   .capture_us = capture_us,
                   .tag = stream.tag()},
                  &clock, message);
  const Bytes join{2, 160, 160, 1, 2, 0x9f, 0x9f}, key{3, 1, 0xbf};
  const Bytes& payload = sequence == 0 ? join : key;
  message.insert(message.end(), payload.begin(), payload.end());
  return message;
}

Bytes manifest_of(const std::vector<Sha256>& chunks) {
  Manifest manifest;
  for (const Sha256& chunk : chunks) manifest.chunks.emplace_back().id = chunk;
  return write_manifest(manifest);
}

Key key_number(int i) {
  Key key;
  key.bands = 3;
  key.step = 100;
  key.q.resize(24);
  const int n = i % 977;  // Long streams have large numbers, whose squares do not fit.
  for (int j = 0; j < 24; ++j) key.q[static_cast<std::size_t>(j)] = (n * n * (j + 1)) % 977 - 400 + 7 * j;
  return key;
}

Bytes FakeSender::next(TimeUs capture_us) {
  const Key key = key_number(static_cast<int>(sequence_));
  if (!state_) {
    const ChainState first = advanced({}, key, 0);
    Bytes message = framed(FrameKind::kJoin, 0, capture_us, encode_join(small_layout(), first).value());
    state_ = first;
    return message;
  }
  Bytes message = framed(FrameKind::kKey, 0, capture_us, encode_key(small_layout(), *state_, key, 0).value().payload);
  state_ = advanced(state_, key, state_->age_us);
  return message;
}

Bytes FakeSender::carry_on(std::uint8_t of, TimeUs capture_us) {
  tag = of;
  state_ = advanced(state_, key_number(static_cast<int>(sequence_)), capture_us - last_us_);
  return framed(FrameKind::kJoin, 0, capture_us, encode_join(small_layout(), *state_).value());
}

Generation::Segment segment_of(int first, int count, const AssetDigest& asset) {
  std::vector<Key> keys;
  for (int i = first; i < first + count; ++i) keys.push_back(key_number(i));
  CodedSegment coded = encode_segment(small_layout(), asset, keys, 1).value();
  const std::string id = sha256(coded.bytes).hex();
  return {id, std::move(coded.segment), 0, std::make_shared<const Bytes>(std::move(coded.bytes))};
}

Bytes FakeSender::next_recalled(TimeUs capture_us, const PoseMemory& memory, std::uint32_t phase) {
  const Key key = key_number(static_cast<int>(sequence_));
  const CodedKey coded = encode_recalled_key(small_layout(), *state_, memory, phase, key, 3).value();
  Bytes message = framed(FrameKind::kKey, Envelope::kRecalled, capture_us, coded.payload);
  state_ = advanced(state_, coded.key, state_->age_us, phase);
  return message;
}

/// Its age is that of the state from then on.
Bytes FakeSender::framed(FrameKind kind, std::uint8_t flags, TimeUs capture_us, const Bytes& payload) {
  Envelope head;
  head.sequence = sequence_++;
  head.capture_us = capture_us;
  head.bands = 3;
  head.kind = kind;
  head.flags = flags;
  head.tag = tag;
  if (kind == FrameKind::kJoin && state_) head.age_us = capture_us - last_us_;
  const ChainClock newest{sequence_ - 2, last_us_, state_ ? state_->age_us : 0};
  Bytes message;
  append_envelope(head, &newest, message);
  message.insert(message.end(), payload.begin(), payload.end());
  if (state_) state_->age_us = capture_us - last_us_;
  last_us_ = capture_us;
  return message;
}

void FakeReceiver::on_stream_changed(const Stream& stream, bool restart) {
  infos.push_back(stream.info_for(*this));
  const control::StreamInfo& info = infos.back();
  reader_.begin(info.stream_id, info.tag, info.epoch);
  reads_ = true;
  if (!restart) return;
  state_.reset();
  reader_.restart();
}

void FakeReceiver::on_restart(const Stream&) {
  state_.reset();
  reader_.restart();
}

void FakeReceiver::on_frames(const Stream&, std::span<const FramePtr> received) {
  for (const FramePtr& frame : received) on_frame(frame);
}

void FakeReceiver::on_frame(const FramePtr& frame) {
  frames.push_back(frame);
  decode(*frame);
}

void FakeReceiver::on_trace(const std::shared_ptr<const std::string>& text) {
  const bool short_one = static_cast<unsigned char>((*text)[1]) < 126;
  traces.push_back(text->substr(short_one ? 2 : 4));
}

void FakeReceiver::decode(const Frame& frame) {
  const auto parsed = parse_frame(frame.message());
  if (!parsed) return void(++undecodable);
  const auto read = reader_.read(*parsed);
  if (reads_ && (!read || read->envelope != frame.envelope)) return void(++undecodable);
  const Envelope& head = frame.envelope;
  if (head.kind == FrameKind::kJoin) {
    auto state = decode_join(small_layout(), head.bands, parsed->payload, head.is_recalled());
    if (!state || (state->phase && !(memory && memory->has(*state->phase)))) return void(++undecodable);
    state_ = *state;
    state_->age_us = head.age_us;
    newest_ = head.sequence;
    newest_us_ = head.capture_us;
    show(head, state_->newer);
  } else if (head.kind == FrameKind::kKey) {
    if (!state_ || head.sequence != newest_ + 1) return void(++undecodable);
    std::optional<std::uint32_t> phase;
    const auto key = [&]() -> Result<Key> {
      if (!head.is_recalled()) return decode_key(small_layout(), head.bands, *state_, parsed->payload);
      if (!memory) return fail(ErrorCode::kCorrupt, "no memory");
      auto recalled = decode_recalled_key(small_layout(), head.bands, *state_, *memory, parsed->payload);
      if (!recalled) return recalled.error();
      phase = recalled->phase;
      return recalled->key;
    }();
    if (!key) return void(++undecodable);
    state_ = advanced(state_, *key, head.capture_us - newest_us_, phase);
    newest_ = head.sequence;
    newest_us_ = head.capture_us;
    show(head, *key);
  } else {
    if (!state_ || head.sequence != newest_) return void(++undecodable);
    auto pose = made(head);
    if (pose && !head.bands.empty())
      pose = decode_residual(small_layout(), head.bands, *std::move(pose), parsed->payload);
    if (!pose) return void(++undecodable);
    poses.push_back({head, *pose});
  }
}

void FakeReceiver::show(const Envelope& head, const Key& key) {
  if (!head.is_ahead()) return poses.push_back({head, key});
  if (!head.shows()) return;
  const auto pose = made(head);
  if (!pose) return void(++undecodable);
  Envelope step = head;
  step.kind = FrameKind::kStep;
  step.flags = 0;
  step.capture_us = shown_us(head);
  poses.push_back({step, *pose});
}

Result<Key> FakeReceiver::made(const Envelope& head) const {
  const auto [at, of] = head.step;
  const auto& [older, newer, age_us, phase] = *state_;
  const control::StreamInfo info = infos.empty() ? control::StreamInfo{} : infos.back();
  const Profile::Scheme scheme = info.profile.scheme;
  const StreamFormat& format = info.format;
  if (head.kind == FrameKind::kEstimate)
    return estimate_keys(small_layout(), older, newer, scheme == Profile::Scheme::kDamped, at, of);
  if (scheme != Profile::Scheme::kHermite) return interpolate_keys(small_layout(), older, newer, at, of);
  return hermite_keys(small_layout(), {format.velocity_channels, format.velocity_us}, older, newer, age_us, at, of);
}

}  // namespace eigencast::broker::testing
