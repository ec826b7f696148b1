// SPDX-License-Identifier: MIT
#include "common/motion/forecaster.h"

#include <algorithm>
#include <cassert>
#include <cstdlib>
#include <vector>

namespace eigencast {

Forecaster::Forecaster(std::uint8_t k, TimeUs max_ahead_us, TimeUs max_span_us)
    : k_(k), max_ahead_us_(max_ahead_us), max_span_us_(max_span_us) {
  assert(k >= 1 && k <= 15 && max_ahead_us >= 0 && max_span_us > 0);
}

void Forecaster::reset() {
  last_.reset();
  interval_us_ = 0;
  last_emitted_us_.reset();
  delay_us_.reset();
  samples_.clear();
}

void Forecaster::add_key(std::uint64_t sequence, TimeUs capture_us, TimeUs arrival_us) {
  capture_us = bounded_time(capture_us);
  arrival_us = bounded_time(arrival_us);
  const bool in_order = last_ && sequence > last_->sequence && capture_us > last_->capture_us;
  if (last_ && !in_order) reset();
  const bool follows = in_order && sequence == last_->sequence + 1 && capture_us - last_->capture_us <= max_span_us_;
  interval_us_ = follows ? capture_us - last_->capture_us : 0;
  follow(capture_us, arrival_us, interval_us_);
  last_ = Pacer::KeyTimes{sequence, capture_us, arrival_us};
  next_at_ = 1;
  last_emitted_us_ = std::max(last_emitted_us_.value_or(capture_us), capture_us);
  // Skips poses less than half a step after the last emitted one, which would disturb the pace.
  while (interval_us_ > 0 && next_at_ <= kMaxPerKey &&
         capture_us + interval_us_ * next_at_ / k_ <= *last_emitted_us_ + interval_us_ / (2 * k_))
    ++next_at_;
}

void Forecaster::follow(TimeUs capture_us, TimeUs arrival_us, TimeUs interval_us) {
  const TimeUs offset_us = arrival_us - capture_us;
  if (delay_us_ && std::abs(offset_us - *delay_us_) > kStrayUs) {
    samples_.clear();
    delay_us_.reset();
  }
  samples_.push_back({arrival_us, offset_us});
  while (samples_.size() > Pacer::kMaxArrivals || samples_.front().arrival_us < arrival_us - kWindowUs)
    samples_.pop_front();
  std::vector<TimeUs> offsets;
  for (const Sample& sample : samples_) offsets.push_back(sample.offset_us);
  const TimeUs max_us = *std::min_element(offsets.begin(), offsets.end()) + interval_us / 2;
  const auto late = offsets.begin() + static_cast<std::ptrdiff_t>((offsets.size() - 1) * 9 / 10);
  std::nth_element(offsets.begin(), late, offsets.end());
  const TimeUs target_us = std::min(*late, max_us);
  if (!delay_us_ || target_us >= *delay_us_) {
    delay_us_ = target_us;
  } else {
    const TimeUs passed_us = last_ ? std::max<TimeUs>(0, arrival_us - last_->arrival_us) : 0;
    delay_us_ = std::max(target_us, *delay_us_ - passed_us / kSlew);
  }
}

std::optional<Pacer::Due> Forecaster::next() const {
  if (!last_ || interval_us_ == 0 || next_at_ > kMaxPerKey) return std::nullopt;
  const TimeUs ahead_us = interval_us_ * next_at_ / k_;
  if (ahead_us > max_ahead_us_) return std::nullopt;
  const TimeUs media_us = last_->capture_us + ahead_us;
  return Pacer::Due{last_->sequence, static_cast<std::uint8_t>(next_at_), k_, media_us, media_us + *delay_us_};
}

std::optional<Pacer::Due> Forecaster::pop_due(TimeUs now_us) {
  const auto due = next();
  if (!due || due->due_us > now_us) return std::nullopt;
  ++next_at_;
  last_emitted_us_ = due->capture_us;
  return due;
}

std::optional<TimeUs> Forecaster::next_due_us() const {
  const auto due = next();
  return due ? std::optional(due->due_us) : std::nullopt;
}

}  // namespace eigencast
