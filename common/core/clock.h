// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>

namespace eigencast {

/// Microseconds on some clock. Differences are meaningful on one clock only.
using TimeUs = std::int64_t;

/// Where time comes from. What decides (pacing, playout, queues) takes times as arguments and never holds a Clock.
class Clock {
 public:
  virtual ~Clock() = default;
  virtual TimeUs now_us() const = 0;
};

/// CLOCK_MONOTONIC: never steps, the same for all processes of one machine. Thread-safe.
class SteadyClock final : public Clock {
 public:
  TimeUs now_us() const override;
};

/// A clock that a test moves by hand. Not thread-safe.
class FakeClock final : public Clock {
 public:
  explicit FakeClock(TimeUs start_us = 0) : now_us_(start_us) {}
  TimeUs now_us() const override { return now_us_; }
  void advance(TimeUs by_us) { now_us_ += by_us; }

 private:
  TimeUs now_us_;
};

/// Now on the steady clock.
TimeUs steady_now_us();

}  // namespace eigencast
