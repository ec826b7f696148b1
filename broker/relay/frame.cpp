// SPDX-License-Identifier: MIT
#include "broker/relay/frame.h"

namespace eigencast::broker {

FramePtr make_frame(const Envelope& envelope, ByteView payload) {
  auto frame = std::make_shared<Frame>();
  frame->envelope = envelope;
  frame->message.reserve(Envelope::kBytes + payload.size());
  append_envelope(envelope, frame->message);
  frame->message.insert(frame->message.end(), payload.begin(), payload.end());
  return frame;
}

}  // namespace eigencast::broker
