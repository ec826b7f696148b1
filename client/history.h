// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <deque>
#include <vector>

#include "common/core/clock.h"

namespace eigencast {

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
  /// One quantity, oldest first.
  std::vector<float> values(double HistorySample::*member) const;
  std::size_t size() const { return samples_.size(); }

 private:
  std::deque<HistorySample> samples_;
  TimeUs next_us_ = 0;
};

/// From zero to a round number above all values.
std::array<float, 2> axis_for(const std::vector<float>& values);

}  // namespace eigencast
