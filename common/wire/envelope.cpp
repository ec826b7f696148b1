// SPDX-License-Identifier: MIT
#include "common/wire/envelope.h"

#include <cassert>
#include <limits>

#include "common/wire/limits.h"

namespace eigencast {
namespace {

constexpr unsigned kKindBits = 3;
constexpr std::uint8_t kResidual = 2;  ///< Flag of a step: bands and a payload follow.

Error corrupt_frame(std::string what) {
  return fail(ErrorCode::kCorrupt, "frame: " + std::move(what));
}

bool in_range(TimeUs time_us) {
  return time_us >= 0 && time_us <= limits::kMaxTimeUs;
}

bool is_join(FrameKind kind) {
  return kind == FrameKind::kJoin;
}

/// The capture time of a frame of an even stream, where `newest` is that before it.
TimeUs expected_us(FrameKind kind, InterpolationStep step, const ChainClock& newest) {
  if (kind == FrameKind::kStep) return newest.capture_us - newest.age_us + part_of(newest.age_us, step);
  return newest.capture_us + (kind == FrameKind::kKey ? newest.age_us : part_of(newest.age_us, step));
}

Result<void> check(const Envelope& head, bool has_bands, bool has_payload) {
  const auto [at, of] = head.step;
  const bool none = at == 0 && of == 0, beyond = head.kind == FrameKind::kEstimate;
  const bool between = at >= 1 && of >= 1 && (at <= of || beyond);
  if (!(head.is_key() ? none || (head.is_ahead() && between && at < of) : between))
    return corrupt_frame("interpolation step " + std::to_string(at) + "/" + std::to_string(of) +
                         " does not suit its kind");
  if (head.bands.empty() == has_bands || has_payload != has_bands)
    return corrupt_frame("bands or payload are missing or superfluous");
  return {};
}

}  // namespace

void append_envelope(const Envelope& envelope, const ChainClock* newest, Bytes& out) {
  const FrameKind kind = envelope.kind;
  const bool has_bands = !envelope.bands.empty();
  assert(check(envelope, has_bands, has_bands) && (has_bands || !envelope.is_key()));
  assert(newest != nullptr || kind != FrameKind::kKey);
  ByteWriter writer(out);
  const unsigned flags = kind == FrameKind::kStep && has_bands ? kResidual : envelope.flags;
  writer.u8(static_cast<std::uint8_t>(static_cast<unsigned>(kind) | flags << kKindBits));
  writer.varint(envelope.stream_id);
  writer.u8(envelope.tag);
  if (!is_join(kind)) writer.u8(static_cast<std::uint8_t>(envelope.sequence));
  if (!envelope.is_key() || envelope.is_ahead()) writer.u8(envelope.step.byte());
  if (has_bands) writer.u8(envelope.bands.bits);
  if (is_join(kind)) {
    writer.varint(envelope.sequence);
    writer.varint(static_cast<std::uint64_t>(envelope.capture_us));
    writer.varint(static_cast<std::uint64_t>(envelope.age_us));
  } else if (kind == FrameKind::kKey) {
    writer.varint(zigzag(envelope.capture_us - expected_us(kind, envelope.step, *newest)));
  }
}

Result<WireFrame> parse_frame(ByteView message) {
  if (message.size() > limits::kMaxFrameBytes)
    return fail(ErrorCode::kTooLarge, "frame: " + std::to_string(message.size()) + " bytes are over the limit of " +
                                          std::to_string(limits::kMaxFrameBytes));
  ByteReader reader(message);
  WireFrame frame;
  Envelope& head = frame.envelope;
  const std::uint8_t first = reader.u8();
  const unsigned kind = first & ((1u << kKindBits) - 1), flags = first >> kKindBits;
  if (kind < 1 || kind > 4) return corrupt_frame("unknown kind " + std::to_string(kind));
  head.kind = static_cast<FrameKind>(kind);
  const unsigned known = head.is_key()                   ? Envelope::kAhead | Envelope::kRecalled
                         : head.kind == FrameKind::kStep ? kResidual
                                                         : 0U;
  if ((flags & ~known) != 0) return corrupt_frame("reserved flags are set: " + std::to_string(flags));
  if (head.is_key()) head.flags = static_cast<std::uint8_t>(flags);

  const std::uint64_t stream_id = reader.varint();
  if (stream_id > std::numeric_limits<std::uint32_t>::max()) return corrupt_frame("stream id is out of range");
  head.stream_id = static_cast<std::uint32_t>(stream_id);
  head.tag = reader.u8();
  if (!is_join(head.kind)) frame.check = reader.u8();
  if (!head.is_key() || head.is_ahead()) {
    const std::uint8_t step = reader.u8();
    head.step = {static_cast<std::uint8_t>(step >> 4), static_cast<std::uint8_t>(step & 15)};
  }
  const bool with_bands = head.is_key() || flags == kResidual;
  if (with_bands) head.bands = reader.u8();
  if (is_join(head.kind)) {
    head.sequence = reader.varint();
    head.capture_us = static_cast<TimeUs>(reader.varint());
    head.age_us = static_cast<TimeUs>(reader.varint());
    if (!in_range(head.capture_us) || head.age_us < 0 || head.age_us > head.capture_us)
      return corrupt_frame("capture time or age is out of range");
  } else if (head.kind == FrameKind::kKey) {
    frame.delay_us = unzigzag(reader.varint());
    if (frame.delay_us < -limits::kMaxTimeUs || frame.delay_us > limits::kMaxTimeUs)
      return corrupt_frame("capture time is out of range");
  }
  if (reader.failed()) return corrupt_frame(std::to_string(message.size()) + " bytes end within the envelope");
  frame.payload = message.subspan(reader.position());
  if (const auto ok = check(head, with_bands, !frame.payload.empty()); !ok) return ok.error();
  return frame;
}

std::optional<FrameView> resolved(const WireFrame& frame, const ChainClock* newest, std::uint32_t epoch) {
  FrameView whole{frame.envelope, frame.payload};
  Envelope& head = whole.envelope;
  head.epoch = epoch;
  if (is_join(head.kind)) return whole;
  const bool next = head.kind == FrameKind::kKey;
  if (newest == nullptr || (next && newest->sequence == std::numeric_limits<std::uint64_t>::max())) return std::nullopt;
  head.sequence = newest->sequence + (next ? 1 : 0);
  const auto [at, of] = head.step;
  if (at > of && newest->age_us / of >= limits::kMaxTimeUs / at) return std::nullopt;  // Beyond the range.
  // Times beyond 63 bits come out negative.
  head.capture_us = static_cast<TimeUs>(static_cast<std::uint64_t>(expected_us(head.kind, head.step, *newest)) +
                                        static_cast<std::uint64_t>(frame.delay_us));
  if (frame.check != static_cast<std::uint8_t>(head.sequence) || !in_range(head.capture_us) ||
      (next && head.capture_us <= newest->capture_us))
    return std::nullopt;
  if (next) head.age_us = head.capture_us - newest->capture_us;
  return whole;
}

void EnvelopeReader::begin(std::uint32_t stream_id, std::uint8_t tag, std::uint32_t epoch) {
  if (stream_id != stream_id_ || tag != tag_ || epoch != epoch_) newest_.reset();
  stream_id_ = stream_id;
  tag_ = tag;
  epoch_ = epoch;
}

std::optional<FrameView> EnvelopeReader::read(const WireFrame& frame) {
  if (frame.envelope.stream_id != stream_id_ || frame.envelope.tag != tag_) return std::nullopt;
  const auto whole = resolved(frame, newest_ ? &*newest_ : nullptr, epoch_);
  if (whole && whole->envelope.is_key()) {
    newest_ = ChainClock::after(whole->envelope);
  } else if (!whole && frame.envelope.kind == FrameKind::kKey) {
    newest_.reset();
  }
  return whole;
}

}  // namespace eigencast
