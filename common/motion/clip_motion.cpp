// SPDX-License-Identifier: MIT
#include "common/motion/clip_motion.h"

#include <algorithm>
#include <array>
#include <optional>

#include "common/motion/curve.h"
#include "common/motion/playout_clock.h"

namespace eigencast {
namespace {

double squared_distance(const std::vector<double>& a, const std::vector<double>& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.size(); ++i) sum += (a[i] - b[i]) * (a[i] - b[i]);
  return sum;
}

}  // namespace

bool ends_where_it_begins(std::span<const std::vector<double>> frames) {
  if (frames.size() < 3) return false;
  double largest = 0;
  for (std::size_t i = 1; i < frames.size(); ++i)
    largest = std::max(largest, squared_distance(frames[i - 1], frames[i]));
  return squared_distance(frames.back(), frames.front()) <= 4 * largest;
}

std::vector<double> ClipMotion::at(TimeUs time_us, bool loops) const {
  const auto count = static_cast<std::int64_t>(frames.size());
  const auto after = std::upper_bound(times_us.begin(), times_us.end(), time_us);
  const std::int64_t from = std::max<std::int64_t>(1, after - times_us.begin()) - 1;
  const bool wraps = loops && is_cycle;
  // Frames by their number, which goes on beyond both ends of a cycle.
  const auto frame = [&](std::int64_t i) -> const std::vector<double>& {
    return frames[static_cast<std::size_t>((i + count) % count)];
  };
  const auto frame_time = [&](std::int64_t i) -> std::optional<TimeUs> {
    if (!wraps && (i < 0 || i >= count)) return std::nullopt;
    return times_us[static_cast<std::size_t>((i + count) % count)] + (i < 0 ? -period_us : i >= count ? period_us : 0);
  };
  const std::optional<TimeUs> from_us = frame_time(from), to_us = frame_time(from + 1);
  if (!to_us || time_us <= *from_us) return frame(from);
  // As Playout does it: a pause is no neighbour.
  const auto neighbour = [&](std::int64_t i, TimeUs beside_us) {
    const std::optional<TimeUs> at_us = frame_time(i);
    const bool near = at_us &&
                      std::max(*at_us, beside_us) - std::min(*at_us, beside_us) <= PlayoutClock::kLongestSpanUs &&
                      *to_us - *from_us <= PlayoutClock::kLongestSpanUs;
    return near ? at_us : std::nullopt;
  };
  const std::optional<TimeUs> before_us = neighbour(from - 1, *from_us), later_us = neighbour(from + 2, *to_us);
  const CurveWeights w = catmull_rom_weights(before_us, *from_us, *to_us, later_us, time_us);
  std::vector<double> pose(frame(from).size(), 0);
  const std::array<std::pair<double, std::int64_t>, 4> terms{
      {{w.from, from}, {w.to, from + 1}, {w.before, from - 1}, {w.after, from + 2}}};
  for (const auto& [weight, number] : terms) {
    if (weight == 0) continue;
    const std::vector<double>& term = frame(number);
    for (std::size_t i = 0; i < pose.size(); ++i) pose[i] += weight * term[i];
  }
  return pose;
}

}  // namespace eigencast
