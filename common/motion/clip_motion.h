// SPDX-License-Identifier: MIT
#pragma once

#include <span>
#include <vector>

#include "common/core/clock.h"

namespace eigencast {

/// Poses of a clip, each r x c, and their times in microseconds, ascending from 0, all before the period, when the
/// first comes again. The caller keeps the frames. Pure.
struct ClipMotion {
  std::span<const std::vector<double>> frames;
  std::span<const TimeUs> times_us;
  TimeUs period_us = 0;
  bool is_cycle = false;  ///< The step to the first frame belongs to the motion: see ends_where_it_begins().

  /// The pose at a time in [0, period_us), on the curve of catmull_rom_weights(), to the bit a frame at its time. After
  /// the last frame it goes over to the first one of a cycle, else it holds. loops: a cycle's ends have neighbours.
  /// REQUIRES: at least one frame.
  std::vector<double> at(TimeUs time_us, bool loops) const;
};

/// Whether the last frame leads to the first: their distance is at most twice the largest between neighbours.
bool ends_where_it_begins(std::span<const std::vector<double>> frames);

}  // namespace eigencast
