// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>

#include "common/core/clock.h"

namespace eigencast {

/// Tick i is due at start + i / rate, so that no error adds up. A tick that is missed by more than one interval is
/// skipped and counted, never made up for by a burst. Not thread-safe.
class Schedule {
 public:
  struct Options {
    double rate_hz = 30;       ///< Poses a second to send, > 0.
    double clip_rate_hz = 30;  ///< Poses a second of the clip, > 0.
    double speed = 1;          ///< Of the motion, > 0.
    std::size_t frames = 1;    ///< Of the clip, > 0.
    bool loop = true;
    std::uint64_t max_ticks = 0;  ///< Stop after so many; 0: never.
  };
  struct Tick {
    TimeUs due_us = 0;
    std::size_t frame = 0;  ///< Of the clip.
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
