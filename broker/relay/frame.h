// SPDX-License-Identifier: MIT
#pragma once

#include <memory>

#include "common/core/bytes.h"
#include "common/wire/envelope.h"

namespace eigencast::broker {

/// One encoded pose as it leaves: made once, then shared by every subscriber of its profile and never changed.
struct Frame {
  Envelope envelope;
  Bytes message;  ///< Envelope and payload: one binary WebSocket message.
};
using FramePtr = std::shared_ptr<const Frame>;

/// The frame of an envelope and its payload, which is copied.
FramePtr make_frame(const Envelope& envelope, ByteView payload);

}  // namespace eigencast::broker
