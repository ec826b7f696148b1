// SPDX-License-Identifier: MIT
#pragma once

#include "broker/relay/feed.h"
#include "common/wire/control.h"

namespace eigencast::broker {

class Stream;

/// Hears what streams take from their senders: what records, what keeps count of the assets in use, what passes keys
/// on. Called on the stream's event loop, in the order in which things happen; must return at once and must not change
/// the stream.
class StreamTap {
 public:
  virtual ~StreamTap() = default;
  virtual void on_announced(const Stream& stream) = 0;
  virtual void on_key(const Stream& stream, const KeyRecordPtr& record) = 0;
  /// The sender is gone.
  virtual void on_stalled(const Stream& stream) = 0;
  /// The sender told what it knows of a key's way.
  virtual void on_trace(const Stream& /*stream*/, const control::Trace& /*trace*/) {}
  /// The stream is about to be forgotten.
  virtual void on_forgotten(const Stream& stream) = 0;
};

}  // namespace eigencast::broker
