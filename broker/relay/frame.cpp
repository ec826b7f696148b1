// SPDX-License-Identifier: MIT
#include "broker/relay/frame.h"

#include "broker/websocket/protocol.h"

namespace eigencast::broker {

FramePtr make_frame(const Envelope& envelope, ByteView payload) {
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
