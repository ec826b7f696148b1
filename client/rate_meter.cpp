// SPDX-License-Identifier: MIT
#include "client/rate_meter.h"

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

}  // namespace eigencast
