// SPDX-License-Identifier: MIT
#pragma once

#include <memory>

#include "broker/websocket/protocol.h"
#include "common/core/bytes.h"
#include "common/core/clock.h"
#include "common/wire/envelope.h"

namespace eigencast::broker {

/// Times of a frame's stages in the broker, for traces; 0: not reached.
struct FrameTimes {
  TimeUs arrival_us = 0;  ///< Keys: arrival from the sender.
  TimeUs due_us = 0;      ///< End of its hold by the pacer.
  TimeUs written_us = 0;  ///< First write to a viewer's socket.
};

/// One encoded pose: framed once, then shared by every subscriber of its profile and never changed.
struct Frame : std::enable_shared_from_this<Frame> {
  Envelope envelope;
  Bytes wire;                     ///< WebSocket header and message, as written to every socket.
  std::size_t message_begin = 0;  ///< Offset of the message.
  std::uint64_t builds_on = 0;    ///< The newest key that a receiver must have, unless it is a join.
  mutable FrameTimes times;       ///< The only mutable part; belongs to the event loop.

  ByteView message() const { return ByteView(wire).subspan(message_begin); }
};
using FramePtr = std::shared_ptr<const Frame>;

/// `newest`: see append_envelope.
inline FramePtr make_frame(const Envelope& envelope, const ChainClock* newest, ByteView payload) {
  auto frame = std::make_shared<Frame>();
  frame->envelope = envelope;
  frame->builds_on = envelope.sequence - (envelope.kind == FrameKind::kKey ? 1 : 0);
  Bytes head;
  head.reserve(Envelope::kMaxBytes);
  append_envelope(envelope, newest, head);
  ByteWriter writer(frame->wire);
  frame->wire.reserve(websocket::kMaxHeaderBytes + head.size() + payload.size());
  websocket::append_header(websocket::Opcode::kBinary, head.size() + payload.size(), frame->wire);
  frame->message_begin = frame->wire.size();
  writer.bytes(head);
  writer.bytes(payload);
  return frame;
}

}  // namespace eigencast::broker
