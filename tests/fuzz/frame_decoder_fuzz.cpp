// SPDX-License-Identifier: MIT
//
// A hostile broker: announcements and frames in any order into a receiver's decoder. Frames are either arbitrary bytes,
// or an envelope that fits the stream with an arbitrary or a well-made payload, so that chains grow long enough to be
// broken.
#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "sdk/frame_decoder.h"

using namespace eigencast;

namespace {

void require(bool condition) {
  if (!condition) std::abort();
}

control::StreamInfo stream_from(ByteReader& reader) {
  control::StreamInfo info;
  info.state = reader.u8() % 8 == 0 ? control::StreamInfo::State::kWaiting : control::StreamInfo::State::kLive;
  info.stream_id = 1;
  info.epoch = 1u + reader.u8() % 2;
  info.format.codec = std::string(name_of(static_cast<CodecKind>(reader.u8() % 3)));
  info.format.channels = 1u + reader.u8() % 6;
  info.format.rows = 0;
  info.format.band_ends.clear();
  for (unsigned band = 0, bands = 1u + reader.u8() % 3; band < bands; ++band) {
    info.format.rows += 1u + reader.u8() % 5;
    info.format.band_ends.push_back(info.format.rows);
  }
  info.format.velocity_channels = reader.u8() % (info.format.channels / 2 + 1);
  info.profile.scheme = static_cast<Profile::Scheme>(reader.u8() % 4);
  return info;
}

/// A state of the layout with small arbitrary values.
ChainState state_from(const CoefficientLayout& layout, ByteReader& reader) {
  const auto key = [&](std::uint8_t step) {
    std::vector<double> C(layout.size());
    for (double& value : C) value = static_cast<std::int8_t>(reader.u8()) * step_size(step);
    return key_from_coefficients(layout, C, step).value();
  };
  Key older = key(reader.u8());
  return {std::move(older), key(reader.u8()), static_cast<TimeUs>(reader.u32())};
}

class Session {
 public:
  void announce(ByteReader& reader) {
    const control::StreamInfo info = stream_from(reader);
    decoder_.set_stream(info);
    memory_.reset();
    reader_.begin(info.stream_id, 0, info.epoch);
    if (info.state == control::StreamInfo::State::kLive) epoch_ = info.epoch;
  }

  /// A frame, of an envelope that goes on from where the decoder is, or nearly so.
  void send(ByteReader& reader) {
    Envelope head;
    head.kind = static_cast<FrameKind>(1 + reader.u8() % 4);
    head.flags = reader.u8() & (head.is_key() ? Envelope::kAhead | Envelope::kRecalled : 0);
    head.bands = reader.u8();
    const std::uint8_t step = reader.u8();
    if (!head.is_key() || head.is_ahead())
      head.step = {static_cast<std::uint8_t>(1 + (step >> 4) % 15), static_cast<std::uint8_t>(1 + step % 15)};
    if (head.is_key() && head.step.at >= head.step.of) head.step = {};
    head.stream_id = 1;
    head.epoch = epoch_;
    head.sequence = decoder_.newest().value_or(0) + reader.u8() % 3;
    head.capture_us = static_cast<TimeUs>(reader.u32());
    const CoefficientLayout& layout = decoder_.layout();
    const std::uint8_t choice = reader.u8();
    Bytes payload;
    if (choice < 128 || layout.rows == 0) {
      const ByteView bytes = reader.bytes(std::min<std::size_t>(choice, reader.remaining()));
      payload.assign(bytes.begin(), bytes.end());
    } else {
      payload = well_made(head, layout, reader);
    }
    take(message_of(head, payload));
  }

  void take(ByteView message) {
    const auto frame = parse_frame(message);
    if (!frame) return;
    if (const auto whole = reader_.read(*frame)) take(*whole);
  }

  void take(const FrameView& frame) {
    const FrameDecoder::Counts before = decoder_.counts();
    const auto pose = decoder_.decode(frame);
    const FrameDecoder::Counts& after = decoder_.counts();
    require(after.keys >= before.keys && after.rejected >= before.rejected && after.missed >= before.missed);
    if (!pose) return require(after.rejected > before.rejected);
    if (*pose) check(**pose);
  }

  /// A memory of a few poses, or none.
  void remember(ByteReader& reader) {
    const CoefficientLayout& layout = decoder_.layout();
    memory_.reset();
    if (layout.rows > 0 && !layout.is_float()) {
      std::vector<Key> poses;
      for (unsigned count = reader.u8() % 4; poses.size() < count;) {
        poses.push_back(state_from(layout, reader).newer);
        poses.back().step = poses.front().step;
      }
      const auto coded = encode_segment(layout, {}, poses, 3);
      if (coded) memory_ = PoseMemory(layout).with(coded->segment).value();
    }
    decoder_.set_memory(memory_);
  }

  void restart() {
    decoder_.restart();
    reader_.restart();
  }

  /// Whatever came before, a join of a new key that is well made is shown, and one of an epoch that has a band more, to
  /// which a stream changes over that has learnt columns; a late frame is not.
  void end() {
    if (decoder_.layout().rows == 0 || epoch_ == 0) return;
    control::StreamInfo info;
    const CoefficientLayout layout = decoder_.layout();
    info.state = control::StreamInfo::State::kLive;
    info.stream_id = 1;
    info.epoch = epoch_;
    info.format = {layout.rows, layout.channels, layout.band_ends, std::string(name_of(layout.codec))};
    decoder_.set_stream(info);
    ByteReader nothing{ByteView()};
    const ChainState state = state_from(layout, nothing);
    Envelope head;
    head.kind = FrameKind::kJoin;
    head.bands = layout.all_bands();
    head.stream_id = 1;
    head.epoch = epoch_;
    head.sequence = decoder_.newest().value_or(7) + 1;
    const Bytes payload = encode_join(layout, state).value();
    const auto pose = decoder_.decode({head, payload});
    require(pose && *pose && **pose == state.newer);

    ++info.epoch;
    info.format.band_ends.push_back(info.format.rows += 4);
    decoder_.set_stream(info);
    const auto late = decoder_.decode({head, payload});
    require(late && *late == nullptr);
    const ChainState wider = state_from(decoder_.layout(), nothing);
    head.epoch = info.epoch;
    head.bands = decoder_.layout().all_bands();
    ++head.sequence;
    head.age_us = head.capture_us = 1;
    const Bytes next = encode_join(decoder_.layout(), wider).value();
    const auto shown = decoder_.decode({head, next});
    require(shown && *shown && **shown == wider.newer &&
            decoder_.coefficients(**shown).size() == decoder_.layout().size());
  }

 private:
  /// As append_envelope, which takes no heads that are not well made.
  static Bytes message_of(const Envelope& head, const Bytes& payload) {
    const bool join = head.kind == FrameKind::kJoin, residual = head.kind == FrameKind::kStep && payload.size() > 0;
    const auto time = static_cast<std::uint64_t>(head.capture_us);
    Bytes message;
    ByteWriter writer(message);
    const unsigned flags = residual ? 2U : unsigned{head.flags};
    writer.u8(static_cast<std::uint8_t>(static_cast<unsigned>(head.kind) | flags << 3));
    writer.varint(head.stream_id);
    writer.u8(head.tag);
    if (!join) writer.u8(static_cast<std::uint8_t>(head.sequence));
    if (!head.is_key() || head.is_ahead()) writer.u8(head.step.byte());
    if (head.is_key() || residual) writer.u8(head.bands.bits);
    if (join) writer.varint(head.sequence);
    if (head.is_key()) writer.varint(time);
    if (join) writer.varint(time / 2);
    writer.bytes(payload);
    return message;
  }

  Bytes well_made(Envelope& head, const CoefficientLayout& layout, ByteReader& reader) const {
    ChainState state = state_from(layout, reader);
    head.bands = layout.all_bands();
    if (head.is_recalled()) state.phase = reader.u8() % 32;
    if (head.kind == FrameKind::kJoin) return encode_join(layout, state).value();
    if (head.is_recalled() && memory_) {
      const auto coded = encode_recalled_key(layout, state, *memory_, reader.u8() % 32, state.newer, 6);
      return coded ? coded->payload : Bytes();
    }
    const auto coded = encode_key(layout, state, state.newer, layout.codec == CodecKind::kQuantised ? 6 : 0);
    return coded ? coded->payload : Bytes();
  }

  void check(const Key& pose) const {
    const CoefficientLayout& layout = decoder_.layout();
    require(layout.all_bands().includes(pose.bands));
    const std::vector<double> C = coefficients_from_key(layout, pose);
    require(C.size() == layout.size());
    require(std::all_of(C.begin(), C.end(), [](double value) { return std::isfinite(value); }));
  }

  FrameDecoder decoder_;
  EnvelopeReader reader_;
  std::optional<PoseMemory> memory_;
  std::uint32_t epoch_ = 0;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  ByteReader reader(ByteView(data, size));
  Session session;
  session.announce(reader);
  for (int i = 0; i < 64 && reader.remaining() > 0; ++i) {
    switch (reader.u8() % 8) {
      case 0:
        session.announce(reader);
        break;
      case 1:
        session.restart();
        break;
      case 2:
        session.remember(reader);
        break;
      case 3:
        session.take(reader.bytes(std::min<std::size_t>(reader.u8(), reader.remaining())));
        break;
      default:
        session.send(reader);
    }
  }
  session.end();
  return 0;
}
