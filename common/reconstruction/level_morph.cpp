// SPDX-License-Identifier: MIT
#include "common/reconstruction/level_morph.h"

#include <algorithm>
#include <cassert>
#include <numeric>

namespace eigencast {
namespace {

/// The change of a weight that takes `duration_us` from 0 to 1.
float step_of(TimeUs elapsed_us, TimeUs duration_us) {
  return elapsed_us < duration_us ? static_cast<float>(elapsed_us) / static_cast<float>(duration_us) : 1.0F;
}

}  // namespace

MorphPace MorphPace::of(double way_px) {
  const double us = 1e6 * way_px / kPixelsPerSecond;
  MorphPace pace;
  if (us < double{kAppear}) pace.appear_us = static_cast<TimeUs>(std::max(us, 0.0));
  pace.vanish_us = std::min(pace.appear_us, kVanish);
  return pace;
}

void LevelMorph::jump(std::uint32_t N) {
  whole_ = N;
  weights_.clear();
}

bool LevelMorph::advance(std::uint32_t N, TimeUs now_us, const MorphPace& pace) {
  const bool settled = drawn() == N && weights_.empty();
  const TimeUs elapsed = seen_us_ ? now_us - *seen_us_ : kOutOfSight;
  seen_us_ = now_us;
  if (settled) return false;
  if (elapsed >= kOutOfSight || drawn() == 0) {
    jump(N);
    return true;
  }
  if (N < whole_) {
    weights_.insert(weights_.begin(), whole_ - N, 1.0F);
    whole_ = N;
  }
  if (N > drawn()) weights_.resize(N - whole_, 0.0F);
  const TimeUs step = std::clamp<TimeUs>(elapsed, 0, kMaxStep);
  const float up = step_of(step, pace.appear_us), down = step_of(step, pace.vanish_us);
  const std::size_t stay = N - whole_;
  for (std::size_t i = 0; i < stay; ++i) weights_[i] = std::min(1.0F, weights_[i] + up);
  for (std::size_t i = stay; i < weights_.size(); ++i) weights_[i] = std::max(0.0F, weights_[i] - down);
  assert(std::is_sorted(weights_.rbegin(), weights_.rend()));
  while (weights_.size() > stay && weights_.back() == 0) weights_.pop_back();
  const auto moving = std::find_if(weights_.begin(), weights_.begin() + static_cast<std::ptrdiff_t>(stay),
                                   [](float weight) { return weight < 1; });
  whole_ += static_cast<std::uint32_t>(moving - weights_.begin());
  weights_.erase(weights_.begin(), moving);
  return true;
}

double LevelMorph::effective() const {
  return std::accumulate(weights_.begin(), weights_.end(), static_cast<double>(whole_));
}

void LevelMorph::blend(std::span<const std::uint32_t> map, std::span<float> values) const {
  assert(values.size() >= 3 * std::size_t{drawn()});
  for (std::size_t i = 0; i < weights_.size(); ++i) {
    float* y = &values[3 * (whole_ + i)];
    const float* from = &values[3 * std::size_t{map[whole_ + i]}];
    for (std::size_t d = 0; d < 3; ++d) y[d] = from[d] + weights_[i] * (y[d] - from[d]);
  }
}

void LevelMorph::share(std::span<const std::uint32_t> map, std::span<float> sums) const {
  assert(sums.size() >= 3 * std::size_t{drawn()});
  for (std::size_t i = weights_.size(); i-- > 0;) {
    const float* own = &sums[3 * (whole_ + i)];
    float* from = &sums[3 * std::size_t{map[whole_ + i]}];
    for (std::size_t d = 0; d < 3; ++d) from[d] += (1 - weights_[i]) * own[d];
  }
  for (std::size_t i = 0; i < weights_.size(); ++i) {
    float* own = &sums[3 * (whole_ + i)];
    const float* from = &sums[3 * std::size_t{map[whole_ + i]}];
    for (std::size_t d = 0; d < 3; ++d) own[d] = weights_[i] * own[d] + (1 - weights_[i]) * from[d];
  }
}

}  // namespace eigencast
