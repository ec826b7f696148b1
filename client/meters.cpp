// SPDX-License-Identifier: MIT
#include "client/meters.h"

#include <algorithm>

#include "view/paint.h"

namespace eigencast {
namespace {

constexpr TimeUs kWindowUs = 2'000'000;
constexpr TimeUs kGrainUs = 50'000;
constexpr TimeUs kMinSpanUs = 200'000;

}  // namespace

void RateMeter::sample(std::uint64_t total, TimeUs now_us) {
  if (total == 0) samples_.clear();  // Waiting for the first one does not count.
  if (!samples_.empty() && (total < samples_.back().second || now_us < samples_.back().first)) samples_.clear();
  if (samples_.size() >= 2 && now_us - samples_[samples_.size() - 2].first < kGrainUs) {
    samples_.back() = {now_us, total};
  } else {
    samples_.emplace_back(now_us, total);
  }
  while (samples_.size() > 2 && now_us - samples_[1].first >= kWindowUs) samples_.pop_front();
}

double RateMeter::per_second() const {
  if (samples_.size() < 2) return 0;
  const TimeUs span = samples_.back().first - samples_.front().first;
  if (span < kMinSpanUs) return 0;
  return static_cast<double>(samples_.back().second - samples_.front().second) * 1e6 / static_cast<double>(span);
}

bool Stillness::look(bool changed, TimeUs now_us) {
  const TimeUs spent = now_us - since_us_;
  if (changed) since_us_ = now_us, spacing_us_ = spent < kApart ? spent : 0;
  const TimeUs late = std::min(spacing_us_ * 8 / 5, std::max(spacing_us_ * 5 / 4, kSoon));
  return now_us - since_us_ >= std::max(kStill, late);
}

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
  for (const HistorySample& sample : samples_) values.push_back(static_cast<float>(sample.*member));
  return values;
}

std::array<float, 2> axis_for(const std::vector<float>& values) {
  const float largest = values.empty() ? 0 : *std::max_element(values.begin(), values.end());
  return {0, largest > 0 ? static_cast<float>(round_up(static_cast<double>(largest))) : 1};
}

}  // namespace eigencast
