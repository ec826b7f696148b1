// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <optional>
#include <utility>
#include <vector>

#include "common/core/clock.h"

namespace eigencast {

/// The growth of a counter over the last two seconds; merges samples closer than 50 ms. Not thread-safe.
class RateMeter {
 public:
  /// A total that shrinks, as of a new session, starts afresh.
  void sample(std::uint64_t total, TimeUs now_us);
  /// Growth a second; 0 before 200 ms have been seen.
  double per_second() const;

 private:
  std::deque<std::pair<TimeUs, std::uint64_t>> samples_;
};

/// Adds up the work on a picture between start() and stop(), without waiting for poses or the display.
class WorkClock final {
 public:
  void start(TimeUs now_us) { began_us_ = now_us; }
  void stop(TimeUs now_us) {
    if (began_us_) spent_us_ += now_us - *began_us_;
    began_us_.reset();
  }
  TimeUs spent_us() const { return spent_us_; }
  /// Returns the sum and begins the next picture.
  TimeUs take() { return std::exchange(spent_us_, 0); }

 private:
  std::optional<TimeUs> began_us_;
  TimeUs spent_us_ = 0;
};

/// Tells when a picture stands still, so that there is time for a better one. Slow motion does not stand still between
/// its pictures: there the next one has to be late. Time comes in as an argument. Not thread-safe.
class Stillness final {
 public:
  static constexpr TimeUs kStill = 60'000, kSoon = 95'000;  ///< At least; at most after 13 pictures a second and more.
  static constexpr TimeUs kApart = 500'000;                 ///< Changes further apart are no motion.

  /// changed: since the last call. True while it stands still.
  bool look(bool changed, TimeUs now_us);

 private:
  TimeUs since_us_ = 0, spacing_us_ = 0;
};

struct HistorySample {
  double lod = 0;         ///< Drawn part of all vertices.
  double drawn_hz = 0;    ///< Pictures a second.
  double control = 0;     ///< LodResolver::state().
  double latency_ms = 0;  ///< Capture to picture, of the newest pose drawn.
  double kbit_per_s = 0;
};

/// The last minute, a sample every 100 ms. Time comes in as an argument. Not thread-safe.
class History {
 public:
  static constexpr TimeUs kEveryUs = 100'000;
  static constexpr std::size_t kMaxSamples = 600;

  /// Keeps the sample if one is due; true if so.
  bool add(const HistorySample& sample, TimeUs now_us);
  /// Oldest first.
  std::vector<float> values(double HistorySample::*member) const;
  std::size_t size() const { return samples_.size(); }

 private:
  std::deque<HistorySample> samples_;
  TimeUs next_us_ = 0;
};

/// Spans zero to a round number above all values.
std::array<float, 2> axis_for(const std::vector<float>& values);

}  // namespace eigencast
