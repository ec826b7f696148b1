// SPDX-License-Identifier: MIT
#pragma once

#include <memory>

#include "common/core/bytes.h"
#include "common/wire/envelope.h"

namespace eigencast::broker {

/// One encoded pose as it leaves: made and framed once, then shared by every subscriber of its profile and never
/// changed.
struct Frame {
  Envelope envelope;
  Bytes wire;                     ///< What goes to every socket: the WebSocket header, then the message.
  std::size_t message_begin = 0;  ///< Where the message begins in it.

  /// Envelope and payload: one binary WebSocket message.
  ByteView message() const { return ByteView(wire).subspan(message_begin); }
};
using FramePtr = std::shared_ptr<const Frame>;

/// The frame of an envelope and its payload, which is copied.
FramePtr make_frame(const Envelope& envelope, ByteView payload);

}  // namespace eigencast::broker
