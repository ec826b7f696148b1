// SPDX-License-Identifier: MIT
#include "client/history.h"

#include <algorithm>

#include "view/paint.h"

namespace eigencast {

bool History::add(const HistorySample& sample, TimeUs now_us) {
  if (now_us < next_us_) return false;
  // After a pause the next one is due from now: missed samples are not caught up.
  next_us_ = std::max(next_us_ + kEveryUs, now_us + kEveryUs / 2);
  if (samples_.size() == kMaxSamples) samples_.pop_front();
  samples_.push_back(sample);
  return true;
}

std::vector<float> History::values(double HistorySample::*member) const {
  std::vector<float> values;
  values.reserve(samples_.size());
  for (const HistorySample& sample : samples_) values.push_back(static_cast<float>(sample.*member));
  return values;
}

std::array<float, 2> axis_for(const std::vector<float>& values) {
  const float largest = values.empty() ? 0 : *std::max_element(values.begin(), values.end());
  return {0, largest > 0 ? static_cast<float>(round_up(static_cast<double>(largest))) : 1};
}

}  // namespace eigencast
