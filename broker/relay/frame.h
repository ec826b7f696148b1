// SPDX-License-Identifier: MIT
#pragma once

#include <memory>

#include "common/core/bytes.h"
#include "common/core/clock.h"
#include "common/wire/envelope.h"

namespace eigencast::broker {

/// When the stages of a frame's life in the broker happened, for traces; 0: did not.
struct FrameTimes {
  TimeUs arrival_us = 0;  ///< Of keys: it came from the sender then.
  TimeUs due_us = 0;      ///< It was held until then.
  TimeUs left_us = 0;     ///< It was handed to the first viewer's socket.
};

/// One encoded pose as it leaves: made and framed once, then shared by every subscriber of its profile and never
/// changed.
struct Frame {
  Envelope envelope;
  Bytes wire;                     ///< What goes to every socket: the WebSocket header, then the message.
  std::size_t message_begin = 0;  ///< Where the message begins in it.
  mutable FrameTimes times;       ///< The one thing that is not fixed; belongs to the event loop.

  /// Envelope and payload: one binary WebSocket message.
  ByteView message() const { return ByteView(wire).subspan(message_begin); }
};
using FramePtr = std::shared_ptr<const Frame>;

/// The frame of an envelope and its payload, which is copied.
FramePtr make_frame(const Envelope& envelope, ByteView payload);

}  // namespace eigencast::broker
