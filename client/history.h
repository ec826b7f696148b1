// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <deque>
#include <vector>

#include "common/core/clock.h"

namespace eigencast {

/// What the plots show over time.
struct HistorySample {
  double lod = 0;         ///< Part of the vertices that are drawn, of all surfaces.
  double drawn_hz = 0;    ///< Pictures a second.
  double control = 0;     ///< What the resolver holds: kappa, or the planned part of a picture's time.
  double latency_ms = 0;  ///< Capture to picture, of the newest pose drawn.
  double kbit_per_s = 0;
};

/// The last minute, a sample every 100 ms. Time comes in as an argument. Not thread-safe.
class History {
 public:
  static constexpr TimeUs kEveryUs = 100'000;
  static constexpr std::size_t kMost = 600;

  /// Keeps the sample if it is time for one; says whether it did.
  bool add(const HistorySample& sample, TimeUs now_us);
  /// One quantity, oldest first.
  std::vector<float> values(double HistorySample::*member) const;
  std::size_t size() const { return samples_.size(); }

 private:
  std::deque<HistorySample> samples_;
  TimeUs next_us_ = 0;
};

/// The ends of a plot's axis: zero, and a round number above all values.
std::array<float, 2> axis_for(const std::vector<float>& values);

}  // namespace eigencast
