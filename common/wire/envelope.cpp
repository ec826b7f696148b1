// SPDX-License-Identifier: MIT
#include "common/wire/envelope.h"

#include <cassert>

#include "common/wire/limits.h"

namespace eigencast {
namespace {

constexpr unsigned kKindBits = 3;

Error corrupt_frame(std::string what) {
  return fail(ErrorCode::kCorrupt, "frame: " + std::move(what));
}

bool is_key_or_join(FrameKind kind) {
  return kind == FrameKind::kKey || kind == FrameKind::kJoin;
}

Result<void> check(const Envelope& envelope, std::size_t payload_bytes) {
  const std::uint8_t known_flags = is_key_or_join(envelope.kind) ? Envelope::kAhead : 0;
  if ((envelope.flags & ~known_flags) != 0)
    return corrupt_frame("reserved flags are set: " + std::to_string(envelope.flags));

  const auto [at, of] = envelope.step;
  const bool beyond = envelope.kind == FrameKind::kEstimate;
  const bool step_ok = is_key_or_join(envelope.kind) ? at == 0 && of == 0 : at >= 1 && of >= 1 && (at <= of || beyond);
  if (!step_ok)
    return corrupt_frame("interpolation step " + std::to_string(at) + "/" + std::to_string(of) +
                         " does not suit its kind");

  if (envelope.kind == FrameKind::kStep) {
    if (!envelope.bands.empty() || payload_bytes != 0) return corrupt_frame("a step carries bands or a payload");
  } else if (beyond) {
    if (envelope.bands.empty() != (payload_bytes == 0))
      return corrupt_frame("it carries bands or a payload, but not both");
  } else if (envelope.bands.empty() || payload_bytes == 0) {
    return corrupt_frame("it carries no bands or no payload");
  }
  if (envelope.capture_us < 0 || envelope.capture_us > limits::kMaxTimeUs)
    return corrupt_frame("capture time is out of range");
  return {};
}

}  // namespace

void append_envelope(const Envelope& envelope, Bytes& out) {
  assert(check(envelope, envelope.bands.empty() ? 0 : 1));
  assert(envelope.step.of <= limits::kMaxInterpolation);
  ByteWriter writer(out);
  writer.u8(static_cast<std::uint8_t>(static_cast<unsigned>(envelope.kind) | unsigned{envelope.flags} << kKindBits));
  writer.u8(envelope.bands.bits);
  writer.u8(envelope.step.byte());
  writer.u32(envelope.stream_id);
  writer.u32(envelope.epoch);
  writer.u64(envelope.sequence);
  writer.u64(static_cast<std::uint64_t>(envelope.capture_us));
}

Result<FrameView> parse_frame(ByteView message) {
  if (message.size() > limits::kMaxFrameBytes) {
    return fail(ErrorCode::kTooLarge, "frame: " + std::to_string(message.size()) + " bytes are over the limit of " +
                                          std::to_string(limits::kMaxFrameBytes));
  }
  if (message.size() < Envelope::kBytes) {
    return corrupt_frame(std::to_string(message.size()) + " bytes are less than an envelope's " +
                         std::to_string(Envelope::kBytes));
  }
  ByteReader reader(message);
  FrameView frame;
  Envelope& envelope = frame.envelope;
  const std::uint8_t first = reader.u8();
  const unsigned kind = first & ((1u << kKindBits) - 1);
  if (kind < 1 || kind > 5) return corrupt_frame("unknown kind " + std::to_string(kind));
  envelope.kind = static_cast<FrameKind>(kind);
  envelope.flags = first >> kKindBits;
  envelope.bands = reader.u8();
  const std::uint8_t step = reader.u8();
  envelope.step = {static_cast<std::uint8_t>(step >> 4), static_cast<std::uint8_t>(step & 15)};
  envelope.stream_id = reader.u32();
  envelope.epoch = reader.u32();
  envelope.sequence = reader.u64();
  const std::uint64_t capture_us = reader.u64();
  if (capture_us > std::uint64_t{limits::kMaxTimeUs}) return corrupt_frame("capture time is out of range");
  envelope.capture_us = static_cast<TimeUs>(capture_us);
  frame.payload = message.subspan(Envelope::kBytes);
  if (const auto checked = check(envelope, frame.payload.size()); !checked) return checked.error();
  return frame;
}

}  // namespace eigencast
