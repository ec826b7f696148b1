// SPDX-License-Identifier: MIT
#pragma once

#include <chrono>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "sdk/subscriber.h"

namespace eigencast {

class Truth;

/// Where the viewer's poses come from. Seen by the applications only through this, so that tests feed them without a
/// network.
///
/// Use from one thread. asset(), epoch() and info() change only inside poll().
class PoseSource {
 public:
  virtual ~PoseSource() = default;
  /// Waits at most `timeout` for news and returns the poses that came, oldest first. All are of epoch(), and their
  /// asset() can be drawn: poses of a surface that has yet to arrive are kept back until it has.
  virtual std::vector<ReceivedPose> poll(std::chrono::milliseconds timeout) = 0;
  /// The surface as far as it has arrived; null before its first part. Valid until the next poll().
  virtual const Asset* asset() const = 0;
  virtual std::uint32_t epoch() const = 0;
  virtual const std::optional<control::StreamInfo>& info() const = 0;
  virtual Subscriber::Stats stats() const = 0;
  /// What its poses should look like; null where that is not known here. The source keeps it.
  virtual Truth* truth() const { return nullptr; }
};

/// The source that watches a stream of a broker. Errors: as Subscriber::create.
Result<std::unique_ptr<PoseSource>> subscribe_to(SubscriberOptions options, LogSink log = {});

}  // namespace eigencast
