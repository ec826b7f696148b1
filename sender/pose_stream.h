// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/core/clock.h"
#include "common/core/result.h"

namespace eigencast {

/// A stream of bytes, as `eigencast-sender pipe` reads it; little-endian:
///
///   stream = [header] pose*
///   header = "ECPOSES1", u32 flags (bit 0: poses have times; others 0), u32 vertices
///   pose   = [f64 time in seconds, if the header says so] f32 x, y, z for each vertex
///
/// Without a header the stream is poses from its first byte on: the header's first bytes would be a coordinate of
/// 3.5e9. Holds one pose. Not thread-safe.
class PoseStream {
 public:
  explicit PoseStream(std::size_t vertices);

  /// Never empty, never beyond the pose (or header) under way.
  std::span<char> room();
  /// True when a pose is whole; it stays until room() is called again. Errors: kCorrupt (another mesh, unknown flags).
  Result<bool> filled(std::size_t bytes);

  const std::vector<float>& positions() const { return positions_; }
  std::optional<double> time_s() const { return time_s_; }
  std::uint64_t count() const { return count_; }
  /// Counts those of a pose that has only begun.
  std::size_t unfinished_bytes() const { return done_ ? 0 : filled_; }

 private:
  enum class Phase { kStart, kHeader, kPose };
  std::size_t pose_bytes() const { return (timed_ ? sizeof(double) : 0) + positions_.size() * sizeof(float); }

  std::size_t vertices_;
  Phase phase_ = Phase::kStart;
  bool timed_ = false;
  bool done_ = false;  ///< The buffer holds a whole pose.
  std::vector<char> buffer_;
  std::size_t filled_ = 0;
  std::vector<float> positions_;
  std::optional<double> time_s_;
  std::uint64_t count_ = 0;
};

/// When piped poses are due. A source that falls behind its own times by more than `kPatienceUs` is not made up for:
/// time starts anew there, and that is counted. Pure. Not thread-safe.
class PipePace {
 public:
  static constexpr TimeUs kPatienceUs = 100'000;
  /// rate_hz: 0: as they arrive, or at the times they state.
  explicit PipePace(double rate_hz) : rate_hz_(rate_hz) {}

  /// Later than all before. Errors: kCorrupt (a stated time that is not finite or not after the one before).
  Result<TimeUs> due_us(TimeUs arrival_us, std::optional<double> time_s);
  std::uint64_t restarts() const { return restarts_; }

 private:
  double rate_hz_;
  std::uint64_t poses_ = 0, restarts_ = 0;
  TimeUs anchor_us_ = 0, last_us_ = 0;
  double first_s_ = 0, last_s_ = 0;
};

/// Tick i is due at start + i / rate, so that no error adds up. A tick that is missed by more than one interval is
/// skipped and counted, never made up for by a burst. Not thread-safe.
class Schedule {
 public:
  struct Options {
    double rate_hz = 30;       ///< Poses a second to send, > 0.
    double clip_rate_hz = 30;  ///< Poses a second of the clip, > 0.
    double speed = 1;          ///< Scales the motion, > 0.
    std::size_t frames = 1;    ///< Counts the clip's, > 0.
    bool loop = true;
    std::uint64_t max_ticks = 0;  ///< Stop after so many; 0: never.
  };
  struct Tick {
    TimeUs due_us = 0;
    std::size_t frame = 0;  ///< Indexes the clip.
  };

  Schedule(const Options& options, TimeUs start_us) : options_(options), start_us_(start_us) {}

  /// Nothing when the clip is over.
  std::optional<Tick> next(TimeUs now_us);
  std::uint64_t skipped() const { return skipped_; }

 private:
  TimeUs due_us(std::uint64_t tick) const;

  Options options_;
  TimeUs start_us_;
  std::uint64_t tick_ = 0;
  std::uint64_t skipped_ = 0;
};

}  // namespace eigencast
