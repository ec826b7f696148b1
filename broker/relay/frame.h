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
struct Frame {
  Envelope envelope;
  Bytes wire;                     ///< WebSocket header and message, as written to every socket.
  std::size_t message_begin = 0;  ///< Offset of the message.
  mutable FrameTimes times;       ///< The only mutable part; belongs to the event loop.

  ByteView message() const { return ByteView(wire).subspan(message_begin); }
};
using FramePtr = std::shared_ptr<const Frame>;

inline FramePtr make_frame(const Envelope& envelope, ByteView payload) {
  auto frame = std::make_shared<Frame>();
  frame->envelope = envelope;
  frame->wire.reserve(websocket::kMaxHeaderBytes + Envelope::kBytes + payload.size());
  websocket::append_header(websocket::Opcode::kBinary, Envelope::kBytes + payload.size(), frame->wire);
  frame->message_begin = frame->wire.size();
  append_envelope(envelope, frame->wire);
  frame->wire.insert(frame->wire.end(), payload.begin(), payload.end());
  return frame;
}

}  // namespace eigencast::broker
