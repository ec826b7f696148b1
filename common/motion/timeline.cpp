// SPDX-License-Identifier: MIT
#include "common/motion/timeline.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <utility>

namespace eigencast {
namespace {

std::int64_t floor_divided(std::int64_t a, std::int64_t b) {
  return a / b - (a % b < 0 ? 1 : 0);
}

}  // namespace

Timeline::Timeline(std::vector<TimeUs> times_us, TimeUs period_us, TimeUs now_us)
    : times_us_(std::move(times_us)), period_us_(period_us), since_us_(now_us) {
  assert(!times_us_.empty() && times_us_.front() == 0 && times_us_.back() < period_us_);
}

TimeUs Timeline::played_us(TimeUs now_us) const {
  if (paused_) return from_us_;
  return from_us_ + std::llround(speed_ * static_cast<double>(now_us - since_us_));
}

Timeline::Moment Timeline::at(TimeUs now_us) const {
  const TimeUs played = played_us(now_us);
  if (!looping_) return {0, std::clamp<TimeUs>(played, 0, end_us())};
  const std::int64_t lap = floor_divided(played, period_us_);
  return {lap, played - lap * period_us_};
}

std::size_t Timeline::frame_at(TimeUs position_us) const {
  const auto after = std::upper_bound(times_us_.begin(), times_us_.end(), position_us);
  return static_cast<std::size_t>(std::max<std::ptrdiff_t>(1, after - times_us_.begin()) - 1);
}

std::optional<TimeUs> Timeline::until_next_us(TimeUs now_us) const {
  const TimeUs position = at(now_us).position_us;
  if (paused_ || (!looping_ && position >= end_us())) return std::nullopt;
  const std::size_t next = frame_at(position) + 1;
  const TimeUs next_us = next < times_us_.size() ? times_us_[next] : period_us_;
  return static_cast<TimeUs>(std::ceil(static_cast<double>(next_us - position) / speed_));
}

void Timeline::go_on_from(TimeUs position_us, TimeUs now_us) {
  from_us_ = position_us;
  since_us_ = now_us;
}

void Timeline::seek(TimeUs position_us, TimeUs now_us) {
  const TimeUs last = looping_ ? period_us_ - 1 : end_us();
  go_on_from(position_us > last ? end_us() : std::max<TimeUs>(0, position_us), now_us);
}

void Timeline::step(std::int64_t frames, TimeUs now_us) {
  const TimeUs position = at(now_us).position_us;
  const std::size_t present = frame_at(position);
  if (frames < 0 && position > times_us_[present]) ++frames;
  const auto count = static_cast<std::int64_t>(times_us_.size());
  const std::int64_t wanted = static_cast<std::int64_t>(present) + frames;
  const std::int64_t found =
      looping_ ? wanted - count * floor_divided(wanted, count) : std::clamp<std::int64_t>(wanted, 0, count - 1);
  go_on_from(times_us_[static_cast<std::size_t>(found)], now_us);
  paused_ = true;
}

void Timeline::set_paused(bool paused, TimeUs now_us) {
  if (paused == paused_) return;
  const TimeUs position = at(now_us).position_us;
  const bool over = !paused && !looping_ && position >= end_us();
  go_on_from(over ? 0 : position, now_us);
  paused_ = paused;
}

void Timeline::set_looping(bool looping, TimeUs now_us) {
  if (looping == looping_) return;
  go_on_from(std::min(at(now_us).position_us, looping ? period_us_ : end_us()), now_us);
  looping_ = looping;
}

void Timeline::set_speed(double speed, TimeUs now_us) {
  const double wanted = std::clamp(speed, kMinSpeed, kMaxSpeed);
  if (wanted == speed_) return;
  go_on_from(at(now_us).position_us, now_us);
  speed_ = wanted;
}

double next_speed(double speed, bool faster) {
  constexpr std::array kSpeeds{Timeline::kMinSpeed, 0.2, 0.5, 1.0, 2.0, 5.0, Timeline::kMaxSpeed};
  const auto above = std::upper_bound(kSpeeds.begin(), kSpeeds.end(), speed);
  const auto from = std::lower_bound(kSpeeds.begin(), kSpeeds.end(), speed);
  if (faster) return above == kSpeeds.end() ? kSpeeds.back() : *above;
  return from == kSpeeds.begin() ? kSpeeds.front() : *(from - 1);
}

}  // namespace eigencast
