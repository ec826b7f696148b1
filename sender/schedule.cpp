// SPDX-License-Identifier: MIT
#include "sender/schedule.h"

#include <cmath>

namespace eigencast {

TimeUs Schedule::due_us(std::uint64_t tick) const {
  return start_us_ + static_cast<TimeUs>(std::llround(static_cast<double>(tick) * 1e6 / options_.rate_hz));
}

std::optional<Schedule::Tick> Schedule::next(TimeUs now_us) {
  // The newest tick that is due is the one to send; those before it are too late to be worth anything.
  while (due_us(tick_ + 1) <= now_us) {
    ++tick_;
    ++skipped_;
  }
  if (options_.max_ticks > 0 && tick_ >= options_.max_ticks) return std::nullopt;
  const double position = static_cast<double>(tick_) * options_.speed * options_.clip_rate_hz / options_.rate_hz;
  auto frame = static_cast<std::uint64_t>(position + 1e-6);
  if (frame >= options_.frames) {
    if (!options_.loop) return std::nullopt;
    frame %= options_.frames;
  }
  return Tick{due_us(tick_++), static_cast<std::size_t>(frame)};
}

}  // namespace eigencast
