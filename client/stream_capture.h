// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <vector>

#include "client/clip_source.h"

namespace eigencast {

/// Keeps all poses of a stream for some time, as a clip that can then be played as slowly as drawing needs. Poses that
/// the broker estimates beyond its keys are left out. Not thread-safe.
class StreamCapture {
 public:
  static constexpr std::size_t kMaxBytes = std::size_t{1} << 30;  ///< Of coefficients.

  /// The source must outlive it.
  explicit StreamCapture(PoseSource& source) : source_(source) {}

  /// Whether the whole surface has come; poses are kept from then on.
  bool has_surface() const;
  /// Forgets what it has but the newest pose, which the capture begins with: several begin at one time.
  void begin();
  /// Takes what has come, waiting at most `timeout`; of a past that begins, that alone. Where the sender goes on in
  /// another basis all poses are in the last one. Errors: kTooLarge (kMaxBytes), kUnsupported (the sender came back
  /// with another surface).
  Result<void> take(std::chrono::milliseconds timeout);
  /// From the first to the last pose that it has.
  TimeUs length_us() const { return times_us_.empty() ? 0 : times_us_.back() - times_us_.front(); }
  bool is_empty() const { return frames_.empty(); }
  /// The sender or the broker is gone, or the past that was shown has come to its end.
  bool is_lost() const;

  /// The clip of what was taken, without a loop's seam. REQUIRES: has_surface(), not is_empty().
  std::shared_ptr<const BakedClip> clip();

 private:
  PoseSource& source_;
  std::vector<std::vector<double>> frames_;
  std::vector<TimeUs> times_us_, utc_us_;  ///< Capture times.
  Result<void> change_over(const control::StreamInfo& info);

  std::optional<control::StreamInfo> info_;
  Asset asset_;  ///< Whose poses the frames are.
  std::uint32_t channels_ = 3;
  std::size_t bytes_ = 0;
  bool ended_ = false;  ///< After a past the stream is live again.
};

/// Whether all chunks of its surface, texture included, are there.
bool has_whole_surface(const PoseSource& source);

}  // namespace eigencast
