// SPDX-License-Identifier: MIT
#pragma once

#include <chrono>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/motion/timeline.h"
#include "sdk/subscriber.h"

namespace eigencast {

/// Distances between the vertices shown and the exact surface. Not thread-safe.
class Truth {
 public:
  virtual ~Truth() = default;
  /// In the asset's units, of the first vertices, from the pose C (r x channels) of that capture time and the positions
  /// (N x 3) rebuilt from it; false if they are unknown, see why().
  virtual bool errors(std::span<const double> C, std::uint32_t channels, std::optional<TimeUs> capture_us,
                      std::span<const float> positions, std::span<float> errors) = 0;
  virtual std::string why() const = 0;
  /// Over the diagonal of the rest box: of the whole surface (rms), of any of the vertices of errors().
  struct Difference {
    double rms = 0, largest = 0;
  };
  /// Of the last errors(), where another stream is the truth.
  virtual std::optional<Difference> difference() const { return std::nullopt; }
};

/// A stream, a clip, a test. Use from one thread. asset(), epoch() and info() change only inside poll().
class PoseSource {
 public:
  virtual ~PoseSource() = default;
  /// Waits at most `timeout` and returns the poses that came, oldest first. All belong to epoch() and to an asset()
  /// that can be drawn; others are held until it can.
  virtual std::vector<ReceivedPose> poll(std::chrono::milliseconds timeout) = 0;
  /// Holds as much as has arrived; null before the first chunk. Valid until the next poll().
  virtual const Asset* asset() const = 0;
  virtual std::uint32_t epoch() const = 0;
  /// How asset() came in place of that of the epoch before; null: it has nothing to do with that. As asset().
  virtual const ChangeOver* change() const { return nullptr; }
  virtual const std::optional<control::StreamInfo>& info() const = 0;
  virtual Subscriber::Stats stats() const = 0;
  /// When a pose of the present epoch was captured, since 1970; of a clip from a file, from its beginning.
  virtual TimeUs utc_us(TimeUs capture_us) const { return info() ? utc_of(*info(), capture_us) : capture_us; }
  /// As Subscriber's.
  virtual std::optional<SharedMoment> moment() const { return std::nullopt; }
  virtual void report_late(TimeUs /*needed_lag_us*/) {}
  /// The exact surface, if it is known here; else null. Owned by the source.
  virtual Truth* truth() const { return nullptr; }
  /// Of a clip, which is played as this says, and whose poses come exactly when they are to be shown: nothing is held
  /// back or estimated. Null: of a stream. Owned by the source, valid until the next poll().
  virtual Timeline* timeline() const { return nullptr; }
  /// Of a stream that may have a past. Null: of a clip. Owned by the source.
  virtual Rewind* rewind() { return nullptr; }
  /// All poses, each r x c row-major, where they are known before they are shown.
  virtual std::span<const std::vector<double>> motion() const { return {}; }
};

/// Errors: as Subscriber::create.
Result<std::unique_ptr<PoseSource>> subscribe_to(SubscriberOptions options, LogSink log = {});

}  // namespace eigencast
