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
  bool is_key = false;            ///< Or a join: later frames build on it.
  std::uint64_t builds_on = 0;    ///< The newest key that a receiver must have, unless it is a join.
  mutable FrameTimes times;       ///< The only mutable part; belongs to the event loop.

  ByteView message() const { return ByteView(wire).subspan(message_begin); }
};
using FramePtr = std::shared_ptr<const Frame>;

inline FramePtr make_frame(const Envelope& envelope, ByteView payload) {
  auto frame = std::make_shared<Frame>();
  frame->envelope = envelope;
  frame->is_key = envelope.kind == FrameKind::kKey || envelope.kind == FrameKind::kJoin;
  // The next key builds on it, a synthetic pose leads to the next key, steps and estimates start at it
  // (docs/protocol.md, section 5).
  const bool leads = envelope.kind == FrameKind::kKey || envelope.kind == FrameKind::kSynthetic;
  frame->builds_on = envelope.sequence - (leads ? 1 : 0);
  frame->wire.reserve(websocket::kMaxHeaderBytes + Envelope::kBytes + payload.size());
  websocket::append_header(websocket::Opcode::kBinary, Envelope::kBytes + payload.size(), frame->wire);
  frame->message_begin = frame->wire.size();
  append_envelope(envelope, frame->wire);
  frame->wire.insert(frame->wire.end(), payload.begin(), payload.end());
  return frame;
}

}  // namespace eigencast::broker
