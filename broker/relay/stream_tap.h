// SPDX-License-Identifier: MIT
#pragma once

#include "broker/relay/feed.h"
#include "common/wire/control.h"

namespace eigencast::broker {

class Stream;

/// Observes the input of streams: recorder, asset store, backbone, mirrors. Called on the stream's event loop, in order;
/// must return at once and must not change the stream.
class StreamTap {
 public:
  virtual ~StreamTap() = default;
  virtual void on_announced(const Stream& stream) = 0;
  virtual void on_key(const Stream& stream, const KeyRecordPtr& record) = 0;
  /// The sender disconnected.
  virtual void on_stalled(const Stream& stream) = 0;
  /// The sender sent its trace of a key.
  virtual void on_trace(const Stream& /*stream*/, const control::Trace& /*trace*/) {}
  virtual void on_forgotten(const Stream& stream) = 0;
};

}  // namespace eigencast::broker
